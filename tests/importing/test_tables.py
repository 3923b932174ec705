"""Tables of times, poses and joints in the forms that other programs write."""

import json
from pathlib import Path

import numpy as np
import pytest

from svmdist.errors import SourceError
from svmdist.importing import tables
from svmdist.importing.tables import (
    parse_stamp_ns,
    read_joints,
    read_poses,
    read_table,
    read_times,
    stamps_from_names,
)
from svmdist.transforms import make_transform, quaternion_xyzw_from_rotation, rotation_of

T = make_transform(rotation_of([0.3, -0.2, 0.5]), [0.01, -0.02, 0.15])
IMAGES_NS = {"1_L.jpg": 10**9, "2_L.jpg": 2 * 10**9}


def _pose_files() -> dict[str, str]:
    x, y, z = T[:3, 3]
    qx, qy, qz, qw = quaternion_xyzw_from_rotation(T[:3, :3])
    flat = " ".join(f"{value:.17g}" for value in T[:3].ravel())
    return {
        "fk": f"stamp_ns,x_m,y_m,z_m,qx,qy,qz,qw\n1000000000,{x},{y},{z},{qx},{qy},{qz},{qw}\n",
        "tum": f"# timestamp x y z qx qy qz qw\n1.0 {x} {y} {z} {qx} {qy} {qz} {qw}\n",
        "tum, bare": f"1.0 {x} {y} {z} {qx} {qy} {qz} {qw}\n",
        "kitti, timed": f"1.0 {flat}\n",
        "matrix": f"{flat}\n{flat}\n",
        "euroc": "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n"
        f"1000000000,{x},{y},{z},{qw},{qx},{qy},{qz}\n",
        "millimetres by image": "image;x_mm;y_mm;z_mm;qx;qy;qz;qw\n"
        f"1;{x * 1e3};{y * 1e3};{z * 1e3};{qx};{qy};{qz};{qw}\n",
        "rostopic": "%time,field.header.seq,field.header.stamp,field.header.frame_id,"
        + ",".join(f"field.pose.position.{axis}" for axis in "xyz")
        + "".join(f",field.pose.orientation.{axis}" for axis in "xyzw")
        + f"\n1000000000000000000,7,1000000000000000000,base,{x},{y},{z},{qx},{qy},{qz},{qw}\n",
        **{
            f"parts {names}": f"{names},x,y,z,qx,qy,qz,qw\n1000000000,5000000,{x},{y},{z},{qx},{qy},{qz},{qw}\n"
            for names in ("secs,nsecs", "sec,nanosec", "header.stamp.secs,header.stamp.nsecs")
        },
        "file names": f"qw,qx,qy,qz,z,y,x,file\n{qw},{qx},{qy},{qz},{z},{y},{x},left/1_L.jpg\n",
    }


@pytest.mark.parametrize("form", _pose_files())
def test_poses(tmp_path, form):
    """Every form gives the same pose at the same time."""
    path = tmp_path / "poses.csv"
    path.write_text(_pose_files()[form])
    poses = read_poses(path, IMAGES_NS, 1.0, "base")
    since_1970 = {
        "rostopic": 10**18,
        "parts": 10**18 + 5_000_000,
    }  # two columns are one stamp, to the nanosecond
    assert poses.stamps_ns[0] == since_1970.get(form.split()[0], 10**9)
    np.testing.assert_allclose(poses.T_parent_child[0], T, atol=1e-12)


def test_joints(tmp_path):
    """Names, units behind them, and names from elsewhere."""
    path = tmp_path / "joints.csv"
    path.write_text("stamp,yaw_deg,insertion_mm,roll\n0.5,90,100,0.25\n0.75,45,110,0.5\n")
    joints = read_joints(path, IMAGES_NS)
    assert joints.names == ("yaw", "insertion", "roll")
    assert joints.stamps_ns.tolist() == [500_000_000, 750_000_000]
    np.testing.assert_allclose(joints.positions, [[np.pi / 2, 0.1, 0.25], [np.pi / 4, 0.11, 0.5]])
    path.write_text(
        "secs,nsecs,position.yaw,position.roll_deg,velocity.yaw,effort_roll,header.seq\n7,5,0.1,90,fast,3,1\n"
    )
    joints = read_joints(path, IMAGES_NS)
    assert (joints.names, joints.stamps_ns.tolist()) == (("yaw", "roll"), [7_000_000_005])
    np.testing.assert_allclose(joints.positions, [[0.1, np.pi / 2]])
    for flat in (
        "# Topic: /PSM1/measured_js\ntimestamp,effort.0,header.frame_id,header.stamp.nanosec,header.stamp.sec,"
        "name.0,name.1,position.0,position.1\n9000000000000000000,,,500000000,1,pitch,yaw,0.5,0.25\n"
        "9000000000000000001,,,500000000,2,pitch,yaw,0.75,0.125\n",
        "%time,field.header.stamp,field.name0,field.name1,field.position0,field.position1,field.velocity0\n"
        "9,1.5,pitch,yaw,0.5,0.25,\n9,2.5,pitch,yaw,0.75,0.125,\n",
    ):  # as the dVRK's data_collection and `rostopic echo -p` write the arrays of a message
        path.write_text(flat)
        joints = read_joints(path, IMAGES_NS)
        assert (joints.names, joints.stamps_ns.tolist()) == (("pitch", "yaw"), [1_500_000_000, 2_500_000_000]), flat
        np.testing.assert_allclose(joints.positions, [[0.5, 0.25], [0.75, 0.125]])
    path.write_text("stamp,name.0,position.0\n1,yaw,0.5\n2,roll,0.5\n")
    with pytest.raises(SourceError, match=r"line 3: expected the joint yaw in name\.0, as before, found 'roll'"):
        read_joints(path, IMAGES_NS)
    path.write_text("0.1 0.2\n0.3 0.4\n")
    joints = read_joints(path, IMAGES_NS, ["yaw", "pitch"])
    assert joints.stamps_ns.tolist() == [*IMAGES_NS.values()]
    np.testing.assert_allclose(joints.positions, [[0.1, 0.2], [0.3, 0.4]])


def test_times(tmp_path, caplog):
    """Times by row, by name in any order, and with names of columns; one that is no time's by name is said."""
    path = tmp_path / "times.csv"
    for text in (
        "1.5\n2.5\n",
        "2_L.jpg,2.5\n1_L.jpg,1.5\n",
        "image,timestamp_ms\n1,1500\n2,2500\n",
        "stamp_ns\n1500000000\n2500000000\n",
        "secs,nsecs,image\n2,500000000,2_L.jpg\n1,500000000,1_L.jpg\n",
        "%time,field.sec,field.nanosec\n1.5,9,0\n2.5,9,0\n",
    ):
        path.write_text(text)
        assert read_times(path, [*IMAGES_NS]) == [1_500_000_000, 2_500_000_000], text
    assert not caplog.messages
    sidecar = path.with_suffix(".json")
    frames = [{"cpu_ts": 1_600_000_000, "gst_ts": 0}, {"cpu_ts": 2_600_000_000, "gst_ts": 1}]
    sidecar.write_text(json.dumps({"type": "dc::sidecar@1.0.0", "estimated_latency": 0.1, "frames": frames}))
    assert read_times(sidecar, [*IMAGES_NS]) == [1_500_000_000, 2_500_000_000]
    for text, said in (
        ("[1, 2]", r"times\.json: expected frames with cpu_ts in ns"),
        ("[" * 100_000, r"times\.json: expected frames with cpu_ts in ns"),
        ('{"frames": [{"cpu_ts": 1e30}]}', r"times\.json: line 1: a time must not be negative or beyond 64 bits"),
        ('{"frames": [{"cpu_ts": 1}]}', r"times\.json: 1 times for 2 images"),
    ):
        sidecar.write_text(text)
        with pytest.raises(SourceError, match=said):
            read_times(sidecar, [*IMAGES_NS])
    path.write_text("image,exposure\n1,1.5\n2,2.5\n")
    assert read_times(path, [*IMAGES_NS]) == [1_500_000_000, 2_500_000_000]
    assert "column exposure is taken for the times; their names are: header.stamp, secs" in caplog.text
    path.write_text("1_L.jpg,2024-05-01T10:00:00\n2_L.jpg,2024-05-01T10:00:01\n")
    said = r"line 2: expected a time as a number of s, ms, us or ns, found '2_L\.jpg, 2024-05-01T10:00:01'"
    with pytest.raises(SourceError, match=said):
        read_times(path, [*IMAGES_NS])


def test_stamps():
    """Units by size or by name, to the last nanosecond; names of files; a rate."""
    assert parse_stamp_ns("1479250744123456789") == 1479250744123456789
    assert parse_stamp_ns("1479250744.123456789") == 1479250744123456789
    assert parse_stamp_ns("1479250744123") == 1479250744123 * 10**6
    assert parse_stamp_ns("20", "ms") == 20_000_000
    assert stamps_from_names(["left_1479250744.25.png", "1479250744_500000.jpg"]) is None
    assert stamps_from_names(["left_1479250744.250.png"]) == [1479250744250000000]
    assert stamps_from_names(["1479250744123456789.png"]) == [1479250744123456789]
    assert stamps_from_names(["frame0001.png"]) is None
    assert stamps_from_names(["20241129101500.png"]) is None  # a date
    assert stamps_from_names(["99999999991_500.png"]) is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "an empty table"),
        ("x,y,z\n", "without rows"),
        ("1,2,3,4,5,6,7\n1,2,3\n", "line 2: expected 7 cells, found 3"),
        ("stamp,x,y,z\n1,2,3,4\n", "no column qx"),
        ("stamp;x;y\n1,0;2,0;3,0\n4,0;5,0;6,0\n", "line 2: expected a time as a number, found '1,0'"),
        ("stamp,x,y,z,qx,qy,qz,qw\n1,0,0,0,0,0,0,2\n", "line 2: its quaternion has length 2"),
        ("stamp,x,y,z,qx,qy,qz,qw\n2,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,1\n", "line 3: its time"),
        ("stamp,x,y,z,qx,qy,qz,qw\n1,a,0,0,0,0,0,1\n", "line 2: expected a number, found 'a'"),
        ("stamp,x,y,z,qx,qy,qz,qw\n1,nan,0,0,0,0,0,1\n", "line 2: expected a number, found 'nan'"),
        ("stamp,x,y,z,qx,qy,qz,qw\n-1,0,0,0,0,0,0,1\n", "must not be negative"),
        ("stamp,x,y,z,qx,qy,qz,qw\n1e999999999,0,0,0,0,0,0,1\n", "beyond 64 bits of ns, found 1e999999999"),
        (
            "secs,nsecs,x,y,z,qx,qy,qz,qw\n1,1e7,0,0,0,0,0,0,1\n",
            "line 2: expected a time as a number, found '1 1e7'",
        ),
        ("1," + "1" * 200_000 + "\n", "not a table: field larger than"),
        ("image,x,y,z,qx,qy,qz,qw\n9,0,0,0,0,0,0,1\n", "there is no image '9'"),
        ("x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,1\n", "1 rows for 2 images"),
        ("1,2,3\n1,2,3\n", "expected 7 numbers of a pose"),
        (
            "x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,1\n33,0,150,0,0,0,1\n",
            "line 3: expected a tool within 10 m of its base",
        ),
        (" ".join(["1"] * 12) + "\n" + " ".join(["1"] * 12) + "\n", "no rotation"),
    ],
)
def test_wrong_poses(tmp_path, text, said):
    path = tmp_path / "wrong.csv"
    path.write_text(text)
    with pytest.raises(SourceError, match=r"wrong\.csv") as caught:
        read_poses(path, IMAGES_NS, 1.0, "base")
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("text", "names", "said"),
    [
        ("1,2\n3,4\n", None, "give --joint-names"),
        ("1,2,3\n3,4,5\n", ["yaw"], "columns of numbers for 1 joint names"),
        ("stamp,yaw,yaw\n1,2,3\n", None, "the same joint"),
        ("stamp,x,y,z,qx,qy,qz,qw\n1,0,0,0,0,0,0,1\n", None, "give it as --poses"),
        ("yaw,insertion\n0.1,0.12\n0.1,120\n", None, "line 3: expected insertion in rad or m, at most 10"),
    ],
)
def test_wrong_joints(tmp_path, text, names, said):
    path = tmp_path / "wrong.csv"
    path.write_text(text)
    with pytest.raises(SourceError, match=said):
        read_joints(path, IMAGES_NS, names)


def test_a_table_of_another_clock():
    """One row near one image will do."""
    rows_ns = np.array([0, 1_080_000_000, 5 * 10**9])
    tables.require_common_time(Path("poses.csv"), rows_ns, [*IMAGES_NS.values()])
    tables.require_common_time(Path("poses.csv"), rows_ns[1:2], [*IMAGES_NS.values()])
    for stamps_ns in (rows_ns + 10**12, rows_ns[1:2] + 50_000_000, rows_ns[:1]):
        with pytest.raises(SourceError, match=r"poses\.csv: no row is within 0\.1 s .* 1\.000 s to 2\.000 s"):
            tables.require_common_time(Path("poses.csv"), stamps_ns, [*IMAGES_NS.values()])


def test_a_table_is_a_regular_file_up_to_a_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "MAX_BYTES", 20)
    (tmp_path / "t.csv").write_text("stamp_ns,x\n" + "1,2\n" * 10)
    with pytest.raises(SourceError, match=r"t\.csv: cannot read: it has more than 20 bytes, the limit"):
        read_table(tmp_path / "t.csv")
    for path, why in (
        (tmp_path, "Is a directory"),
        (tmp_path / "nul\0", "a character that no path can have"),
    ):
        with pytest.raises(SourceError, match=f"cannot read: .*{why}"):
            read_table(path)
