"""Settings: frozen, explained one by one, open to a profile."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from benchmarks.generated_pages import meanings
from svmdist.errors import ProfileError
from svmdist.profile import DEFAULT_PROFILE, load_profile, profile_path
from svmdist.profile.settings import MethodSettings, Settings

GROUPS = dict(Settings.model_fields)
FIELDS = [(name, key) for name in GROUPS for key in type(getattr(Settings(), name)).model_fields]


@pytest.mark.parametrize(("name", "key"), FIELDS)
def test_every_setting_says_what_it_means(name: str, key: str) -> None:
    """A sentence that ends, and a default that its own bounds allow."""
    group = getattr(Settings(), name)
    description = meanings(type(group))[key]
    assert description.rstrip().endswith(".")
    type(group)(**{key: getattr(group, key)})


@pytest.mark.parametrize("name", GROUPS)
def test_settings_are_frozen(name: str) -> None:
    group = getattr(Settings(), name)
    assert isinstance(group, MethodSettings)
    for key in type(group).model_fields:
        with pytest.raises(ValidationError, match="frozen"):
            setattr(group, key, getattr(group, key))


def test_a_profile_sets_them(tmp_path) -> None:
    """One key of one table changes that setting alone; a wrong name is told with the nearest right one."""
    text = profile_path(DEFAULT_PROFILE).read_text("utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(text + "\n[settings.shaft]\nmax_position_std_m = 0.002\n", "utf-8")
    changed, shipped = load_profile(path).settings, load_profile().settings
    assert changed.shaft.max_position_std_m == 0.002
    assert changed.model_copy(update={"shaft": shipped.shaft}) == shipped
    path.write_text(text + "\n[settings.shaft]\nmax_positon_std_m = 0.002\n", "utf-8")
    with pytest.raises(
        ProfileError, match=r"settings\.shaft\.max_positon_std_m: did you mean max_position_std_m"
    ):
        load_profile(path)
    path.write_text(text + "\n[settings.shaft]\nmax_position_std_m = -1\n", "utf-8")
    with pytest.raises(ProfileError, match=r"settings\.shaft\.max_position_std_m: .*greater than 0"):
        load_profile(path)
