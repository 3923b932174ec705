from google.protobuf import timestamp_pb2 as _timestamp_pb2
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class DistanceEstimate(_message.Message):
    __slots__ = ["timestamp", "instrument", "method", "status", "detail", "planar_m", "planar_std_m", "spatial_m", "spatial_std_m", "clearance_m", "clearance_std_m", "clearance_low_m", "clearance_high_m", "to_instrument_m", "to_instrument_std_m", "alarm", "closing_speed_m_s", "time_to_contact_s", "consistency"]
    TIMESTAMP_FIELD_NUMBER: _ClassVar[int]
    INSTRUMENT_FIELD_NUMBER: _ClassVar[int]
    METHOD_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    PLANAR_M_FIELD_NUMBER: _ClassVar[int]
    PLANAR_STD_M_FIELD_NUMBER: _ClassVar[int]
    SPATIAL_M_FIELD_NUMBER: _ClassVar[int]
    SPATIAL_STD_M_FIELD_NUMBER: _ClassVar[int]
    CLEARANCE_M_FIELD_NUMBER: _ClassVar[int]
    CLEARANCE_STD_M_FIELD_NUMBER: _ClassVar[int]
    CLEARANCE_LOW_M_FIELD_NUMBER: _ClassVar[int]
    CLEARANCE_HIGH_M_FIELD_NUMBER: _ClassVar[int]
    TO_INSTRUMENT_M_FIELD_NUMBER: _ClassVar[int]
    TO_INSTRUMENT_STD_M_FIELD_NUMBER: _ClassVar[int]
    ALARM_FIELD_NUMBER: _ClassVar[int]
    CLOSING_SPEED_M_S_FIELD_NUMBER: _ClassVar[int]
    TIME_TO_CONTACT_S_FIELD_NUMBER: _ClassVar[int]
    CONSISTENCY_FIELD_NUMBER: _ClassVar[int]
    timestamp: _timestamp_pb2.Timestamp
    instrument: str
    method: str
    status: str
    detail: str
    planar_m: float
    planar_std_m: float
    spatial_m: float
    spatial_std_m: float
    clearance_m: float
    clearance_std_m: float
    clearance_low_m: float
    clearance_high_m: float
    to_instrument_m: float
    to_instrument_std_m: float
    alarm: bool
    closing_speed_m_s: float
    time_to_contact_s: float
    consistency: float
    def __init__(self, timestamp: _Optional[_Union[_timestamp_pb2.Timestamp, _Mapping[str, int]]] = ..., instrument: _Optional[str] = ..., method: _Optional[str] = ..., status: _Optional[str] = ..., detail: _Optional[str] = ..., planar_m: _Optional[float] = ..., planar_std_m: _Optional[float] = ..., spatial_m: _Optional[float] = ..., spatial_std_m: _Optional[float] = ..., clearance_m: _Optional[float] = ..., clearance_std_m: _Optional[float] = ..., clearance_low_m: _Optional[float] = ..., clearance_high_m: _Optional[float] = ..., to_instrument_m: _Optional[float] = ..., to_instrument_std_m: _Optional[float] = ..., alarm: bool = ..., closing_speed_m_s: _Optional[float] = ..., time_to_contact_s: _Optional[float] = ..., consistency: _Optional[float] = ...) -> None: ...
