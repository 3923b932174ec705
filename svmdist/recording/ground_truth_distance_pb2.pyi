from google.protobuf import timestamp_pb2 as _timestamp_pb2
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class GroundTruthDistance(_message.Message):
    __slots__ = ["timestamp", "planar_m", "spatial_m", "clearance_m"]
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    PLANAR_M_FIELD_NUMBER: _ClassVar[int]
    SPATIAL_M_FIELD_NUMBER: _ClassVar[int]
    CLEARANCE_M_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    planar_m: float
    spatial_m: float
    clearance_m: float
    def __init__(self, timestamp: _Optional[_Union[_timestamp_pb2.Timestamp, _Mapping[str, int]]] = ..., planar_m: _Optional[float] = ..., spatial_m: _Optional[float] = ..., clearance_m: _Optional[float] = ...) -> None: ...
