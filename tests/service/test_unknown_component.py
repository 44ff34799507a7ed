"""What is said of a name that the library has not."""

from wrenchbook.service.library.component import MAX_NAMES, UnknownComponentError


def test_a_small_library_is_told_as_a_whole():
    assert str(UnknownComponentError("x", ["bar", "plate"])).endswith("has: bar, plate.")
    assert str(UnknownComponentError("x", [])).endswith("has: none yet.")


def test_of_a_large_library_the_names_most_like_it_are_told():
    known = [f"rig_{number:04d}" for number in range(1000)] + ["bracket"]
    told = str(UnknownComponentError("brakcet", known))
    assert "bracket" in told
    assert f"and {len(known) - MAX_NAMES} more" in told
    assert len(told) < 400
