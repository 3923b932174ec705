"""The tree of transforms: composed along the path, inverted where an edge is walked backwards."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.errors import RecordingError
from svmdist.recording import tf_tree as transform_tree
from svmdist.recording.tf_tree import TransformTree, find_path, frame_name
from svmdist.samples import TransformSample
from svmdist.transforms import Array, inverse, make_transform, rotation_of

ROUNDING = 1e-12
"""Products of a few matrices of numbers near 1 are exact to some 1e-15; a thousand times that."""
STAMPS_NS = (0, 40_000_000, 80_000_000)
MS = 1_000_000


def transform(seed: int) -> Array:
    """A rigid transform anywhere."""
    rng = np.random.default_rng(seed)
    return make_transform(rotation_of(rng.normal(size=3)), rng.normal(size=3))


def tree(*edges: tuple[str, str], static: tuple[str, ...] = ()) -> TransformTree:
    """A tree whose edges have transforms of their own; those whose child is in `static` hold for the whole log."""
    made = TransformTree()
    for number, (parent, child) in enumerate(edges):
        for step, stamp_ns in enumerate(STAMPS_NS):
            sample = TransformSample(stamp_ns, parent, child, transform(10 * number + step))
            made.add(sample, is_static=child in static)
    return made


def test_a_track_is_the_product_of_the_edges_on_its_path() -> None:
    """T_a_c = T_a_b T_b_c at every stamp that both edges have."""
    made = tree(("a", "b"), ("b", "c"), ("a", "x"))
    track = made.track("a", "c")
    expected = made.track("a", "b").T_parent_child @ made.track("b", "c").T_parent_child
    assert track.stamps_ns.tolist() == list(STAMPS_NS)
    np.testing.assert_allclose(track.T_parent_child, expected, atol=ROUNDING)


@pytest.mark.parametrize(("parent", "child"), [("a", "b"), ("a", "c"), ("x", "c")])
def test_the_way_back_is_the_inverse(parent: str, child: str) -> None:
    made = tree(("a", "b"), ("b", "c"), ("a", "x"), static=("x",))
    there, back = made.track(parent, child), made.track(child, parent)
    assert (there.parent, there.child) == (back.child, back.parent)
    np.testing.assert_allclose(back.T_parent_child, inverse(there.T_parent_child), atol=ROUNDING)


def test_static_edges_hold_at_every_stamp_of_the_moving_ones() -> None:
    """The last message of a static edge counts; a path of static edges alone is static."""
    made = tree(("a", "b"), ("b", "c"), ("c", "d"), static=("b", "d"))
    assert made.track("a", "b").is_static
    np.testing.assert_array_equal(made.track("a", "b").T_parent_child, [transform(2)])
    track = made.track("a", "d")
    assert not track.is_static
    expected = [transform(2) @ transform(10 + step) @ transform(22) for step in range(3)]
    np.testing.assert_allclose(track.T_parent_child, expected, atol=ROUNDING)
    still = tree(("a", "b"), ("b", "c"), static=("b", "c")).track("a", "c")
    assert still.is_static
    np.testing.assert_allclose(still.T_parent_child, [transform(2) @ transform(12)], atol=ROUNDING)


def test_a_stamp_is_left_out_where_an_edge_has_no_value() -> None:
    """Edges with stamps of their own: nothing is extrapolated, and no gap above the limit is bridged."""
    made = TransformTree()
    for stamp_ns in (0, 50 * MS, 100 * MS):
        made.add(TransformSample(stamp_ns, "a", "b", transform(1)), is_static=False)
    for stamp_ns in (50 * MS, 90 * MS, 500 * MS):
        made.add(TransformSample(stamp_ns, "b", "c", transform(2)), is_static=False)
    assert made.track("a", "c").stamps_ns.tolist() == [50 * MS, 90 * MS]
    assert made.track("a", "c", max_gap_ns=10 * MS).stamps_ns.tolist() == [50 * MS]


def test_stamps_out_of_order_are_sorted() -> None:
    made = TransformTree()
    for stamp_ns in (80, 0, 40):
        made.add(TransformSample(stamp_ns, "a", "b", transform(stamp_ns)), is_static=False)
    track = made.track("a", "b")
    assert track.stamps_ns.tolist() == [0, 40, 80]
    np.testing.assert_array_equal(track.T_parent_child, [transform(0), transform(40), transform(80)])


def test_names_of_old_tf_lose_their_slash() -> None:
    made = tree(("/a", "b"), ("b", "/c"))
    assert made.frames == ("a", "b", "c")
    assert frame_name("/a") == frame_name("a") == "a"
    assert len(made.track("a", "c").stamps_ns) == len(STAMPS_NS)


def test_what_cannot_be_linked_is_told() -> None:
    """A frame that is not there, a frame and itself, and two trees, whose frames are named."""
    made = tree(("a", "bone"), ("x", "y\n"))
    with pytest.raises(RecordingError, match=r"no frame bon in the transforms: did you mean bone"):
        made.track("a", "bon")
    with pytest.raises(RecordingError, match="from a to itself"):
        made.track("a", "a")
    with pytest.raises(RecordingError, match=r"on one side are a, bone; on the other x, y\\n"):
        made.track("a", "x")


def test_the_number_of_edges_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transform_tree, "MAX_EDGES", 3)
    made = tree(("a", "b"), ("a", "c"), ("a", "d"))
    with pytest.raises(RecordingError, match="more than 3 pairs of frames"):
        made.add(TransformSample(0, "a", "e", np.eye(4)), is_static=False)


def test_the_shortest_path_is_found_in_either_direction_of_an_edge() -> None:
    edges = [("a", "b"), ("c", "b"), ("c", "d"), ("d", "e"), ("a", "f"), ("e", "f")]
    assert find_path(edges, "a", "c") == [("a", "b"), ("b", "c")]
    assert find_path(edges, "a", "e") == [("a", "f"), ("f", "e")]
    assert find_path(edges, "a", "a") == []
    assert find_path(edges, "a", "nowhere") is None
