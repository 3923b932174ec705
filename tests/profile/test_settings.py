"""Settings: a profile sets them, each acts where it says, keys of older profiles are ignored with a warning."""

import logging
from dataclasses import replace

import pytest
from pydantic import ValidationError

from svmdist.profile import SHIPPED, load_profile
from svmdist.profile.settings import FusedSettings, OutlineSettings, Settings, former_keys
from svmdist.recording.log import open_recording
from svmdist.recording.observations import Window
from svmdist.samples import Status
from svmdist.vision.regions import find_region
from svmdist.workflows.estimate import estimate
from svmdist.workflows.request import Setup, prepare
from tests.shipped import EXACT_PROFILE, PSM13


def test_a_profile_sets_them(tmp_path):
    """One key of one table changes that setting alone."""
    path = tmp_path / "mine.toml"
    path.write_text(PSM13 + "\n[settings.shaft]\nmax_position_std_m = 0.002\n", "utf-8")
    changed, shipped = load_profile(path).settings, load_profile().settings
    assert changed.shaft.max_position_std_m == 0.002
    assert changed.model_copy(update={"shaft": shipped.shaft}) == shipped


def test_keys_of_older_profiles_are_ignored_with_a_warning(tmp_path, caplog):
    """What was a setting once and is a constant now leaves a profile as valid as it was, whatever its table."""
    tables = "".join(f"\n[{table}]\n{min(keys)} = 3\n" for table, keys in former_keys().items())
    path = tmp_path / "mine.toml"
    path.write_text(PSM13 + tables, "utf-8")
    with caplog.at_level(logging.WARNING):
        assert load_profile(path) == load_profile()
    assert len(caplog.messages) == len(former_keys())
    assert "limits.chunk_records is no longer a setting; ignored" in caplog.messages
    assert "settings.silhouette.edge_reach_fraction is no longer a setting; ignored" in caplog.messages
    for table, keys in former_keys().items():
        known = Settings.model_fields.get(table.removeprefix("settings."))
        assert known is None or not keys & set(type(known.default).model_fields)


def test_the_marker_s_outline_is_found_by_the_profile_s_settings(golden, monkeypatch):
    """`overlay` looks for the drawn outline with `[settings.outline]`, as for tissue and instrument."""
    outline, used = OutlineSettings(min_visible_fraction=0.5), []

    def find(mask, rule, settings):
        used.append(settings)
        return find_region(mask, rule, settings)

    monkeypatch.setattr("svmdist.estimation.planar.find_region", find)
    profile = load_profile()
    profile = profile.model_copy(update={"settings": Settings(outline=outline)})
    setup = prepare(profile, calibration=SHIPPED / "psm13.calibration.toml")
    assert next(iter(estimate(open_recording(golden / "sweep.mcap", profile), setup))).status is Status.OK
    assert set(used) == {outline}


@pytest.mark.slow
def test_what_lasts_is_not_averaged_away(golden):
    """`fused` on a log with a tag: the larger the share of an error that lasts, the wider the interval in the end."""
    last_m = []
    for share in (0.0, 0.1, 0.9):
        settings = Settings(fused=FusedSettings(lasting_share=share))
        setup = Setup(EXACT_PROFILE.model_copy(update={"settings": settings}), "fused", "corrected", None)
        whole = open_recording(golden / "3d" / "contact.mcap", setup.profile)
        recording = replace(whole, window=Window(end_s=3.0))
        spatial = [row.distances.spatial for row in estimate(recording, setup) if row.distances.spatial]
        last_m.append(spatial[-1].std_m)
    assert 0.0 < last_m[0] < last_m[1] < last_m[2]
    with pytest.raises(ValidationError):
        FusedSettings(lasting_share=1.0)
