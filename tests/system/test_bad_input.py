"""Bad input and bad moments: one clear message, a non-zero exit code, and nothing half-written."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import time
from pathlib import Path

import pytest
from command_line import CAMERAS, run, start, tiny, tree, wait_for_handler

from support.tiers import few

# What is wrong with a recipe: text to replace in it, and its replacement.
_ROCK = """{rock: {
  ecology: {growth_m_per_yr: 1, max_radius_m: 1, shade_tolerance: 0, old_age_survival: 0, seedlings_per_ha_per_yr: 1},
  allometry: {height_m: {scale: 1, exponent: 1}, width_m: {scale: 1, exponent: 1}}}}"""
MISTAKES = {
    "unknown key": ("seed: 3", "sead: 3"),
    "unknown nested key": ("terrain: flat", "terrane: flat"),
    "unknown key of a model": ("steps: 12", "stepps: 12"),
    "wrong type": ("size_m: [6, 5]", "size_m: big"),
    "text for a number": ("samples: 1,", "samples: '1',"),
    "negative size": ("size_m: [6, 5]", "size_m: [-6, 5]"),
    "negative steps": ("steps: 12", "steps: -1"),
    "no number": ("size_m: [6, 5]", "size_m: [.nan, 5]"),
    "no cameras": (CAMERAS, "cameras: []"),
    "no species": ("{fireweed: }", "{}"),
    "unknown species": ("{fireweed: }", "{firewed: }"),
    "missing species file": ("{fireweed: }", "{fireweed: ./nix.yaml}"),
    "unknown generator": ("{fireweed: }", "{fireweed: {from: fireweed, plant: {generator: magic}}}"),
    "species without generator": ("{fireweed: }", _ROCK),
    "unknown model": ("multiset_lsystem", "multiset"),
    "camera in the clouds": ("render: {", "sky: {clouds: {type: noise, base_m: 1}}\nrender: {clouds: farfield, "),
    "clouds too thick": ("seed: 3", "sky: {clouds: {type: noise, extinction_per_m: 1, thickness_m: 20000}}"),
    "sun below the nadir": ("seed: 3", "sky: {sun: {elevation_deg: -94}}"),
    "no YAML": ("seed: 3", "seed: [3"),
    "a key twice": ("seed: 3", "seed: 3\nseed: 4"),
    "other version": ("forestgen: 1", "forestgen: 99"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_in_the_recipe_is_named_with_its_place_before_any_work(name: str, tmp_path: Path) -> None:
    old, new = MISTAKES[name]
    recipe = tiny(tmp_path, (old, new))
    before = tree(tmp_path)
    for verb in (
        ("render", recipe, "-o", tmp_path / "out"),
        ("simulate", recipe, "-o", tmp_path / "out"),
        ("validate", recipe),
    ):
        run(*verb).refused(2)
        assert tree(tmp_path) == before


def test_the_end_of_a_distribution_is_checked_before_any_image(tmp_path: Path) -> None:
    recipe = tiny(tmp_path, ("seed: 3", "sky: {turbidity: {uniform: [3, 30]}}"))
    run("render", recipe, "-o", tmp_path / "out").refused(2)


@pytest.mark.parametrize(
    "override",
    ["steps", "=3", "a..b=3", "site={", "site.size_m.5=3", "seed=", "seed.x=3", "cameras.0=3", "nonsense=3"],
)
def test_a_bad_override_is_named_as_one(override: str, tmp_path: Path) -> None:
    run("validate", tiny(tmp_path), "--set", override).refused(2)


def test_a_recipe_that_is_none(tmp_path: Path) -> None:
    run("render", tmp_path / "nix.yaml").refused(2)
    run("render", tmp_path).refused(2)
    run("validate", "quickstart").refused(2)
    (tmp_path / "empty.yaml").write_text("")
    run("validate", tmp_path / "empty.yaml").refused(2)
    (tmp_path / "binary.yaml").write_bytes(b"\x89PNG\r\n\x1a\n\0\xff")
    run("validate", tmp_path / "binary.yaml").refused(2)


_NO_COHORT = "{model: multiset_lsystem, program: self_thinning, parameters: {initial_plants_per_ha: 0}}"
_FOREST = "{model: stand, storeys: [{species: {spruce: 1}, stems_per_ha: 800, dominant_height_m: 24}]}"
_SEEDLINGS = "species.fireweed.ecology.seedlings_per_ha_per_yr"
TOO_LARGE = {
    "seedlings": (["site.size_m=[5000,5000]", f"{_SEEDLINGS}=1000000", "community.steps=300"], "community"),
    "exemplars": (
        ["plants.exemplars_per_species=1000", "species.spruce=spruce", "site.size_m=[200,200]", f"community={_FOREST}"],
        "exemplars",
    ),
    "pixels": (["cameras.0.size_px=[16384,16384]"], "images"),
    "label samples": (["labels.samples=1024", "cameras.0.size_px=[8192,4096]"], "images"),
    "clouds": (
        ["sky.clouds={type: noise, extent_m: 20000, thickness_m: 20000, base_m: 2000, extinction_per_m: 0.01}"],
        "clouds",
    ),
}


@pytest.fixture
def _few_gigabytes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine with 8 GB free, whatever this one has."""
    from forestgen.scene import plan

    monkeypatch.setattr(plan, "free_bytes", lambda: 8_000_000_000)


@pytest.mark.usefixtures("_few_gigabytes")
@pytest.mark.parametrize("name", TOO_LARGE)
def test_what_cannot_fit_into_memory_is_refused_before_any_work(name: str, tmp_path: Path) -> None:
    overrides, largest = TOO_LARGE[name]
    recipe = tiny(tmp_path)
    options = [text for one in overrides for text in ("--set", one)]
    for verb in (("validate", recipe), ("render", recipe, "-o", tmp_path / "out")):
        run(*verb, *options).refused(3)
    assert not (tmp_path / "out").exists()
    if largest == "community":
        run("simulate", recipe, "-o", tmp_path / "out", *options).refused(3)


def test_clouds_too_near_for_light_from_afar_are_refused_before_anything_is_rendered(tmp_path: Path) -> None:
    """Above the camera, so that the plan knows nothing of it: the scene's plants decide."""
    low = ("--set", "sky.clouds={type: noise, base_m: 60}")
    recipe = tiny(tmp_path)
    recipe.write_text(recipe.read_text().replace("render: {", "render: {clouds: farfield, "), encoding="utf-8")
    answer = run("render", recipe, "-o", tmp_path / "out", *low)
    answer.refused(2)
    assert "identity" not in answer.err


def test_plants_beyond_memory_are_refused_when_they_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from forestgen.scene import plan

    monkeypatch.setattr(plan, "_BYTES_PER_PLANT", 10**12)
    answer = run("render", tiny(tmp_path), "-o", tmp_path / "out")
    answer.refused(3)
    assert set(tree(tmp_path)) == {"tiny.yaml"}


def test_many_samples_take_time_but_no_memory(tmp_path: Path) -> None:
    assert run("validate", tiny(tmp_path), "--set", "render.samples=65536").code == 0


def test_an_output_that_cannot_be_used_is_refused_before_any_work(tmp_path: Path) -> None:
    recipe = tiny(tmp_path)
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "thesis.tex").write_text("five years")
    before = tree(tmp_path)
    for verb in ("render", "simulate"):
        run(verb, recipe, "-o", recipe).refused(4)
        run(verb, recipe, "-o", recipe / "x").refused(4)
        for more in ((), ("--overwrite",)):
            run(verb, recipe, "-o", taken, *more).refused(4)
        run(verb, recipe, "-o", tmp_path / ("x" * 300)).refused(4, "File name too long")
    assert tree(tmp_path) == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_an_output_without_permission(tmp_path: Path) -> None:
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o500)
    run("render", tiny(tmp_path), "-o", closed / "out").refused(4, "Permission denied")


def _no_permission(*_: object, **__: object) -> None:
    raise OSError(errno.EACCES, os.strerror(errno.EACCES), "closed/out")


def test_an_output_without_permission_even_for_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = tiny(tmp_path)
    monkeypatch.setattr(Path, "mkdir", _no_permission)
    for verb in ("render", "simulate"):
        run(verb, recipe, "-o", tmp_path / "out").refused(4)


def test_a_disk_without_room_for_the_images_is_refused_before_any_work(tmp_path: Path) -> None:
    recipe = tiny(tmp_path)
    for more in ((), ("--overwrite",)):
        answer = run("render", recipe, "-o", tmp_path / "out", "--count", "100000000", *more)
        answer.refused(4, "larger than what is free on the disk", "GB", "100,000,000 images", "--count ")
    assert set(tree(tmp_path)) == {"tiny.yaml"}


def test_a_disk_that_fills_up_halfway_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recipe, out = tiny(tmp_path), tmp_path / "out"
    assert run("simulate", recipe, "-o", out).code == 0
    before = tree(tmp_path)

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        # The last file that a run writes: everything else lies in the hidden folder by then.
        patched.setattr(Path, "write_bytes", full)
        run("simulate", recipe, "-o", out, "--overwrite").refused(4)
    assert tree(tmp_path) == before
    assert run("simulate", recipe, "-o", out).code == 4  # not without --overwrite
    assert run("simulate", recipe, "-o", out, "--overwrite", "--set", "seed=4").code == 0
    assert tree(tmp_path) != before


def test_a_full_file_system_in_earnest(tmp_path: Path) -> None:
    """A limit on the size of files stands in for a full disk: the kernel refuses to write, as it does there."""
    import resource

    recipe, out = tiny(tmp_path, ("size_m: [6, 5]", "size_m: [60, 50]")), tmp_path / "out"
    # Once without a limit, so that all modules and kernels are there: what is refused is the run's own file.
    assert run("simulate", recipe, "-o", out).code == 0
    limit = 20_000
    sizes = [path.stat().st_size for path in out.iterdir()]
    assert min(sizes) < limit < max(sizes)  # some files are written before
    shutil.rmtree(out)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    assert signal.getsignal(signal.SIGXFSZ) == signal.SIG_IGN  # as Python has it
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        answer = run("simulate", recipe, "-o", out)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    answer.refused(4)
    assert set(tree(tmp_path)) == {"tiny.yaml"}


@pytest.mark.parametrize(
    ("override", "reason"),
    few(
        [
            (f"{_SEEDLINGS}=0", "seedlings_per_ha_per_yr is 0 for every species"),
            ("community.steps=0", "community.steps is 0"),
            (f"community={_NO_COHORT}", "initial_plants_per_ha is 0"),
        ]
    ),
)
def test_an_empty_community_is_a_result_with_a_reason(tmp_path: Path, override: str, reason: str) -> None:
    recipe = tiny(tmp_path)
    answer = run("simulate", recipe, "-o", tmp_path / "out", "--set", override)
    assert answer.code == 0, answer.err
    assert "0 plants" in answer.out
    assert "note: no plant can grow: " in answer.out
    assert reason in answer.out
    assert reason in run("validate", recipe, "--set", override).out


def test_an_empty_image_is_a_result_with_a_reason(tmp_path: Path) -> None:
    answer = run("render", tiny(tmp_path), "-o", tmp_path / "bare", "--set", "community.steps=0")
    assert answer.code == 0, answer.err
    assert "note: 000000-camera0 shows bare ground: no plant can grow: community.steps is 0" in answer.out


@pytest.mark.slow
def test_strange_views_and_skies_are_rendered(tmp_path: Path) -> None:
    recipe = tiny(tmp_path)
    cases = {
        "cameras.0={position_m: [3, -3, -5], look_at_m: [3, 30, -30], size_px: [48, 27], obstructed: note}": (
            "stands below the ground"
        ),
        "cameras.0.look_at_m=[3,-300,100]": "sees no plant",
        "cameras.0.look_at_m=[3,-3,0]": "",  # straight down
        "cameras.0={position_m: [3, 3, 0.1], look_at_m: [3, 3.01, 0.1], size_px: [48, 27]}": "",
        "sky.sun.elevation_deg=0.1": "",
        "sky.sun.elevation_deg=90": "",
        "site.size_m=[0.3,0.3]": "",  # smaller than any plant
        "community.steps=1": "",
    }
    for number, (override, note) in enumerate(cases.items()):
        answer = run("render", recipe, "-o", tmp_path / str(number), "--set", override)
        assert answer.code == 0, answer.err
        assert note in answer.out


PLANTS = {
    ("nix",): 2,
    ("sprouce",): 2,
    ("./nix.yaml",): 2,
    ("poplar", "--height-m", "0"): 2,
    ("oak", "--height-m", "200"): 2,
    ("poplar", "--height-m", "-3"): 2,
    ("poplar", "--height-m", "nan"): 2,
    ("poplar", "--height-m", "1e9"): 2,
    ("poplar", "--count", "0"): 2,
    ("poplar", "--frames", "4"): 2,
    ("beech", "--frames", "4", "--count", "2"): 2,
    ("beech", "--frames", "4", "--frames-per-s", "nan"): 2,
    ("fireweed", "--size-px", "0", "9"): 2,
    ("fireweed", "--distance-m", "nan"): 2,
    ("fireweed", "--wood-triangles", "20"): 2,
    ("fireweed", "--distance-m", "0.05", "-o", "a.png"): 2,
    ("fireweed", "--look-at-m", "9", "-o", "a.png"): 2,
    ("poplar", "-o", "tree.stl"): 2,
    ("poplar", "-o", "a.glb", "-o", "a.glb"): 2,
    ("poplar", "-o", "taken.glb"): 4,
    ("poplar", "-o", "other.obj"): 4,
    ("poplar", "--count", "2", "-o", "many.glb"): 4,
    ("poplar", "-o", "taken.glb/x.glb"): 4,
    ("poplar", "-o", "folder.glb"): 4,
}


@pytest.mark.parametrize("arguments", PLANTS)
def test_a_plant_that_cannot_be(arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken.glb").write_text("mine")
    (tmp_path / "other.mtl").write_text("mine")
    (tmp_path / "many-0002.glb").write_text("mine")
    (tmp_path / "folder.glb").mkdir()
    before = tree(tmp_path)
    run("plant", *arguments).refused(PLANTS[arguments])
    assert tree(tmp_path) == before


def test_a_negative_seed_is_refused_by_every_command() -> None:
    for verb in (("plant", "poplar"), ("lsystem", "koch"), ("fit-kernel", "trees.csv")):
        answer = run(*verb, "--seed", "-1")
        assert answer.code == 2
        assert "Invalid value for '--seed'" in answer.err
        assert not answer.out


def test_of_a_plants_files_all_appear_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk is full when the third file of five comes; what was there stays as it was."""
    written = 0

    def fills(path: Path, content: bytes) -> int:
        nonlocal written
        written += ".partial" in path.name
        with path.open("wb") as file:
            count = file.write(content[: 10 if written == 3 else None])
        if written == 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return count

    (tmp_path / "old.ply").write_text("mine")
    before = tree(tmp_path)
    files = [word for name in ("old.ply", "new/a.obj", "new/b/c.usd") for word in ("-o", tmp_path / name)]
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", fills)
        answer = run("plant", "fireweed", "--overwrite", *files)
    answer.refused(4)
    assert ".partial" not in answer.err
    assert tree(tmp_path) == before


# Simulation, growing plants, and rendering; seconds are those of an idle machine and need not be met.
@pytest.mark.parametrize(
    ("number", "code", "delay_s"),
    [
        (signal.SIGINT, 130, 1.0),
        (signal.SIGTERM, 143, 3.5),
        *(pytest.param(signal.SIGINT, 130, 0.7 + 0.65 * k, marks=pytest.mark.slow) for k in range(20)),
    ],
)
def test_a_stopped_run_leaves_nothing(number: signal.Signals, code: int, delay_s: float, tmp_path: Path) -> None:
    quickstart = Path(__file__).parents[2] / "recipes" / "quickstart.yaml"
    process = start("render", quickstart, "--set", "render.samples=4096", "-o", tmp_path / "out")
    wait_for_handler(process, number)
    time.sleep(delay_s)
    process.send_signal(number)
    asked = time.monotonic()
    out, err = process.communicate(timeout=60)
    took_s = time.monotonic() - asked
    assert process.returncode == code, err
    assert "nothing was written" in err
    assert "Traceback" not in err
    assert not out
    assert tree(tmp_path) == {}
    assert took_s < 4.0  # 2 s on a machine that does nothing else


@pytest.mark.slow
def test_two_runs_into_one_folder_leave_one_whole_result(tmp_path: Path) -> None:
    recipe = tiny(tmp_path)
    both = [start("render", recipe, "-o", tmp_path / "out", "--set", f"seed={seed}") for seed in (1, 2)]
    ends = [(*process.communicate(timeout=120), process.returncode) for process in both]
    assert sorted(code for _, _, code in ends) == [0, 4]
    (refusal,) = (err for _, err, code in ends if code == 4)
    assert "already holds a forestgen data set" in refusal or "another run writes there" in refusal
    names = set(tree(tmp_path))
    assert {"out/dataset.json", "out/train/000000-camera0/frame.exr"} <= names
    assert not [name for name in names if name.startswith(".")]
    assert run("verify", tmp_path / "out").code == 0
