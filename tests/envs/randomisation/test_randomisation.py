import pytest

from laploop.assets.tissue_appearance import AppearanceRanges
from laploop.configuration import to_plain
from laploop.envs.randomisation.files import LEVELS, randomisation_of
from laploop.envs.randomisation.randomisation import Randomisation, with_values
from laploop.envs.sensors.optics.presets import OpticsRanges
from laploop.envs.sensors.optics.scope_ranges import ScopeRanges
from laploop.envs.tasks.registry import TASKS, default_config
from laploop.errors import InvalidValueError, MissingFileError, UnknownNameError

YOUNG = "loop.theatre.tissue.material.young_pa"
SERVICE = "loop.timing.service"


def at(config, path):
    value = to_plain(config)
    for part in path.split("."):
        value = value[part]
    return value


def test_values_are_set_at_their_paths_and_nothing_else_is():
    config = default_config("reach")
    changed = with_values(config, {YOUNG: 4000.0, "loop.theatre.motion.breathing_hz": 0.3})
    assert changed.loop.theatre.tissue.material.young_pa == 4000.0
    assert changed.loop.theatre.motion.breathing_hz == 0.3
    assert with_values(changed, {YOUNG: 10_000.0, "loop.theatre.motion.breathing_hz": 0.25}) == config


def test_a_choice_may_replace_a_whole_table_by_one_of_another_kind():
    latency = {"kind": "lognormal", "median_ms": 30.0, "sigma": 0.3}
    randomisation = randomisation_of({SERVICE: {"choice": [latency]}})
    config = default_config("reach")
    randomisation.check(config)
    values = randomisation.draw(config, seed=1)
    assert values == {SERVICE: latency}
    assert with_values(config, values).loop.timing.service.median_ms == 30.0


def test_a_seed_draws_the_same_and_no_path_depends_on_another():
    config = default_config("reach")
    stiffness = {YOUNG: {"uniform": [3000, 12000]}}
    more = {**stiffness, "loop.theatre.tissue.material.friction": {"uniform": [0.01, 0.05]}}
    alone, both = (randomisation_of(one).draw(config, seed=5) for one in (stiffness, more))
    assert alone[YOUNG] == both[YOUNG] == randomisation_of(stiffness).draw(config, seed=5)[YOUNG]
    assert alone[YOUNG] != randomisation_of(stiffness).draw(config, seed=6)[YOUNG]


def test_a_width_scales_what_a_seed_draws_and_at_zero_draws_nothing():
    config = default_config("reach")
    randomisation = randomisation_of({YOUNG: {"uniform": [3000, 12000]}})
    whole, half = (randomisation.draw(config, 5, width)[YOUNG] for width in (1.0, 0.5))
    assert half - 10_000.0 == pytest.approx(0.5 * (whole - 10_000.0))
    assert randomisation.draw(config, 5, 0.0) == {}


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"loop.theatre.tissue.youngs_modulus_pa": {"uniform": [1, 2]}}, UnknownNameError, f"did you mean '{YOUNG}'"),
        ({"theatre.tissue.young_pa": {"uniform": [1, 2]}}, UnknownNameError, f"did you mean '{YOUNG}'"),
        ({YOUNG: {"uniform": [1, 2000]}}, InvalidValueError, r"young_pa is 1.0; allowed: 100 to 1e\+06"),
        ({YOUNG: {"normal": [1000, 400]}}, InvalidValueError, "young_pa is -200.0"),
        ({YOUNG: {"choice": ["soft"]}}, InvalidValueError, "young_pa is 'soft'"),
        ({"loop.theatre.tissue.shape.ridges": {"uniform": [1, 3]}}, InvalidValueError, "ridges is 1.0; allowed: an integer"),
        ({SERVICE: {"choice": [{"kind": "gama"}]}}, UnknownNameError, "did you mean 'gamma'"),
        (
            {
                "loop.theatre.tissue.shape.lobe_width_min_m": {"uniform": [0.02, 0.034]},
                "loop.theatre.tissue.shape.lobe_width_max_m": {"uniform": [0.028, 0.03]},
            },
            InvalidValueError,
            "smallest <= largest",
        ),
    ],
)
def test_what_the_task_does_not_allow_is_refused_before_anything_is_drawn(given, error, words):
    with pytest.raises(error, match=words):
        randomisation_of(given).check(default_config("reach"))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"loop.control_hz": {"choice": [125.0]}}, "loop.control_hz, which all episodes"),
        ({"loop.theatre.scope": {"choice": [{"baseline_m": 0.004}]}}, "loop.theatre.scope.width, which all episodes"),
        ({SERVICE: {"choice": [{}]}, f"{SERVICE}.latency_ms": {"uniform": [1, 2]}}, "none within another"),
    ],
)
def test_paths_that_exclude_each_other_or_change_the_interface_are_refused(given, words):
    with pytest.raises(InvalidValueError, match=words):
        randomisation_of(given)


def test_files_hold_dotted_and_nested_paths(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        f'"{YOUNG}" = {{uniform = [3000, 12000]}}\n[loop.timing]\nservice.latency_ms = {{choice = [10, 20]}}\n',
        encoding="utf-8",
    )
    assert randomisation_of(path).plain == {
        YOUNG: {"uniform": [3000, 12000]},
        f"{SERVICE}.latency_ms": {"choice": [10, 20]},
    }
    assert randomisation_of(str(path)).plain == randomisation_of(path).plain
    assert randomisation_of(randomisation_of(path).plain).plain == randomisation_of(path).plain


def test_bad_files_and_names_are_refused_with_their_place(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(f'"{YOUNG}" = {{unifrom = [3000, 12000]}}\n', encoding="utf-8")
    with pytest.raises(UnknownNameError, match=rf"bad.toml: {YOUNG}: unknown distribution"):
        randomisation_of(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(InvalidValueError, match="UTF-8"):
        randomisation_of(path)
    path.write_text("= 3", encoding="utf-8")
    with pytest.raises(InvalidValueError, match="as TOML"):
        randomisation_of(path)
    with pytest.raises(MissingFileError, match="none, narrow, wide"):
        randomisation_of(tmp_path / "missing.toml")
    with pytest.raises(UnknownNameError, match="did you mean 'wide'"):
        randomisation_of("wid")
    with pytest.raises(InvalidValueError, match="a mapping"):
        randomisation_of(3)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("task", TASKS.names())
def test_levels_are_allowed_in_every_task(level, task):
    config, randomisation = default_config(task), randomisation_of(level)
    randomisation.check(config)
    for seed in range(8):
        with_values(config, randomisation.draw(config, seed))


def test_wide_has_the_ranges_that_networks_are_trained_on_and_the_paths_of_narrow():
    wide, narrow = (randomisation_of(level).plain for level in ("wide", "narrow"))
    assert set(narrow) <= set(wide)
    optics = OpticsRanges()
    for path, span in {
        "tissue.albedo": optics.tissue_albedo,
        "tissue.roughness": optics.tissue_roughness,
        "tissue.reflectance": optics.tissue_reflectance,
        "tissue.subsurface.fwhm_m": optics.subsurface_fwhm_m,
        "tool.albedo": optics.tool_albedo,
        "tool.roughness": optics.tool_roughness,
        "stage.albedo": optics.stage_albedo,
        "glare_fraction": optics.glare_fraction,
        "cavity_fraction": optics.cavity_fraction,
        "source_blur_tan": optics.source_blur_tan,
        "lens_blur_px": optics.lens_blur_px,
        "read_noise_electrons": optics.read_noise_electrons,
        "full_well_electrons": optics.full_well_electrons,
    }.items():
        assert wide[f"loop.optics.{path}"] == {"uniform": list(span)}
    nominal = default_config("reach").loop.optics.led_power_w
    assert wide["loop.optics.led_power_w"]["loguniform"] == pytest.approx([nominal * factor for factor in optics.light])
    scope = ScopeRanges()
    for path, span in {"baseline_m": scope.baseline_m, "mask.duty": scope.duty, "mask.phase": scope.phase}.items():
        assert wide[f"loop.theatre.scope.{path}"] == {"uniform": list(span)}
    appearance = AppearanceRanges()
    for name in ("coverage", "darkness", "patch_size_m"):
        assert wide[f"loop.theatre.tissue.appearance.{name}"] == {"uniform": list(getattr(appearance, name))}


def test_narrow_surrounds_the_nominal_values():
    config, narrow = default_config("reach"), randomisation_of("narrow").plain
    for path, distribution in narrow.items():
        low, high = distribution["uniform"]
        assert low <= at(config, path) <= high, path


def test_none_draws_nothing():
    assert randomisation_of("none").distributions == Randomisation({}).distributions == {}
