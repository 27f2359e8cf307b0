"""Each command as a user meets it."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from command_line import command, run, start, tiny, tree
from ruamel.yaml import YAML

from forestgen.api import diagnosis
from forestgen.cli import app

SPECIES = Path(__file__).parents[2] / "scenes" / "species"
COMMANDS = (
    "render",
    "batch",
    "verify",
    "report",
    "pack",
    "merge",
    "simulate",
    "stand",
    "plant",
    "validate",
    "models",
    "schema",
    "stats",
    "fit-kernel",
    "lsystem",
    "light",
    "weather",
    "calibrate",
    "measure",
    "doctor",
    "completion",
)
HEAVY = (
    "numpy",
    "scipy",
    "mitsuba",
    "drjit",
    "pydantic",
    "rich",
    "ruamel",
    "matplotlib",
    "psutil",
    "forestgen.pipeline",
)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_an_example_that_parses(name: str) -> None:
    answer = run(name, "--help")
    assert answer.code == 0
    example = re.search(r"Example: (forestgen .*)", answer.out, re.DOTALL)
    assert example
    words = example[1].split()
    assert words[:2] == ["forestgen", name]
    assert all(len(line) <= 80 for line in answer.out.splitlines())
    assert not re.search(r"{[A-Z]|<[a-z]", answer.out), "an argument is shown as typer shows it"
    for option in [word for word in words if word.startswith("--")]:
        assert answer.out.count(option) >= 2, f"{option} is not explained"


def test_the_overview_names_all_commands() -> None:
    answer = run("--help")
    assert [line.split()[0] for line in answer.out.split("Commands:")[1].splitlines() if line.startswith("  ")][
        : len(COMMANDS)
    ] == list(COMMANDS)
    assert {one.name or one.callback.__name__ for one in app.registered_commands if one.callback} == set(COMMANDS)
    assert run("--version").out.startswith("forestgen 0.")
    for verb in COMMANDS:
        assert run(verb, "--nonsense").code == 2


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, forestgen\n"
        "from forestgen.cli import main\n"
        "try:\n    main()\n"
        f"finally:\n    print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code, "--help"], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


@pytest.mark.slow
def test_help_is_quick() -> None:
    times = []
    for _ in range(5):
        begun = time.perf_counter()
        subprocess.run(command("--help"), capture_output=True, check=True)
        times.append(time.perf_counter() - begun)
    assert sorted(times)[2] < 0.5


def test_models_lists_and_explains() -> None:
    listing = run("models").out
    for name in ("multiset_lsystem", "silhouette", "fireweed", "poplar", "spruce", "quickstart"):
        assert name in listing
    for name in ("multiset_lsystem", "silhouette"):
        page = run("models", name).out
        assert "Reference" in page
        assert "default" in page
        assert len(page.splitlines()) > 20
    assert "ecology:" in run("models", "spruce").out
    run("models", "sprce").refused(2)


@pytest.fixture(scope="module")
def schema() -> dict[str, object]:
    """The document that `forestgen schema` prints, once: it takes seconds."""
    answer = run("schema")
    assert answer.code == 0
    document: dict[str, object] = json.loads(answer.out)
    return document


def test_schema_is_one_json_document(schema: dict[str, object]) -> None:
    assert str(schema["$schema"]).startswith("https://json-schema.org/")


@pytest.mark.slow
def test_schema_is_a_schema(schema: dict[str, object]) -> None:
    import jsonschema

    jsonschema.Draft202012Validator.check_schema(schema)


def test_schema_agrees_with_the_loader(schema: dict[str, object]) -> None:
    import jsonschema

    validator = jsonschema.Draft202012Validator(schema)
    paths = sorted((Path(__file__).parents[2] / "recipes").glob("*.yaml"))
    recipes = {path.stem: YAML(typ="safe", pure=True).load(path.read_text()) for path in paths}
    for name, recipe in recipes.items():
        assert validator.is_valid(recipe), name
    recipe = recipes["quickstart"]
    for change in (
        {"sead": 3},
        {"site": {"size": [1, 2]}},
        {"site": {"size_m": [-1, 2]}},
        {"cameras": []},
        {"species": {}},
        {"community": {"model": "multiset_lsystem", "stepps": 3}},
        {"community": {"model": "nix"}},
        {"render": {"samples": "many"}},
        {"sky": {"sun": {"elevation": 3}}},
    ):
        assert not validator.is_valid({**recipe, **change}), change
    assert validator.is_valid({**recipe, "sky": {"turbidity": {"uniform": [2, 4]}}})


def test_validate_tells_what_the_recipe_makes(tmp_path: Path) -> None:
    answer = run("validate", tiny(tmp_path), "--set", "images=3", "--set", "sky.turbidity={uniform: [2, 4]}")
    assert answer.code == 0
    for part in ("tiny.yaml: valid", "3 frames: 3 images x 1 camera", "48 x 27 px", "6 x 5 m", "sky.turbidity"):
        assert part in answer.out
    assert re.search(r"up to about [\d.]+ [MG]B to render, [\d.]+ [MG]B to simulate", answer.out)
    assert not answer.err


def test_json_is_one_document_without_notes(tmp_path: Path) -> None:
    answers = {
        "validate": run("validate", tiny(tmp_path), "--set", "community.steps=0", "--json"),
        "models": run("models", "--kind", "species", "--json"),
        "page": run("models", "spruce", "--json"),
        "doctor": run("doctor", "--json"),
        "list": run("plant", "--list", "--json"),
        "plant": run("plant", "fireweed", "-o", tmp_path / "a.ply", "--json", "--quiet"),
    }
    assert {name: (one.code, one.err) for name, one in answers.items()} == dict.fromkeys(answers, (0, ""))
    told = {name: json.loads(one.out) for name, one in answers.items()}
    assert (told["validate"]["valid"], told["validate"]["frames"]) == (True, 1)
    assert "community.steps is 0" in told["validate"]["notes"][0]
    assert {one["kind"] for one in told["models"]} == {"species"}
    assert "ecology:" in told["page"][0]["page"]
    assert told["doctor"]["ready"] is True
    assert {one["name"] for one in told["models"]} == {one["name"] for one in told["list"]}
    assert told["plant"][0]["files"] == {str(tmp_path / "a.ply"): (tmp_path / "a.ply").stat().st_size}


def test_simulate_writes_history_maps_and_curves(tmp_path: Path) -> None:
    answer = run("simulate", tiny(tmp_path), "-o", tmp_path / "out", "--map-step", "0", "--map-step", "12")
    assert answer.code == 0, answer.err
    assert set(tree(tmp_path / "out")) == {
        "animation.gif",
        "curves.png",
        "history.parquet",
        "manifest.json",
        "map-000000.png",
        "map-000012.png",
        "sizes.png",
        "statistics.json",
        "thinning.png",
    }
    assert re.search(r"^\d+ plants? \(\d+ fireweed\)$", answer.out, re.MULTILINE)
    assert re.search(
        r"^living +plants +stems over 1.3 m +stems per ha\nfireweed +\d+ +\d+ +[\d,]+$", answer.out, re.MULTILINE
    )
    run("simulate", tmp_path / "tiny.yaml", "-o", tmp_path / "b", "--map-step", "13").refused(2)
    assert not (tmp_path / "b").exists()


def test_render_names_its_files_and_is_repeated_from_the_stored_recipe(tmp_path: Path) -> None:
    recipe = tiny(tmp_path, ("seed: 3", "seed: 3\nsky: {turbidity: {uniform: [2, 6]}}"))
    answer = run("render", recipe, "-o", tmp_path / "out", "--count", "2", "--verbose")
    assert answer.code == 0, answer.err
    assert answer.err == "writing the files over all images\n"  # no bars, no warnings where there is no terminal
    assert "\x1b" not in answer.out
    for part in ("2 of 2 images done", "2 frames, ", "images an hour", "image 1:", " fireweed); "):
        assert part in answer.out
    assert re.search(r"^time: .*\blight paths \d+ %", answer.out, re.MULTILINE)
    assert f"files: {tmp_path}/out/\n" in answer.out
    view, report = f"{tmp_path}/out/train/000001-camera0", f"{tmp_path}/out/report.html"
    assert f"look at {view}/preview.png and {view}/overlay.png, or at {report}" in answer.out
    first, second = (tree(tmp_path / "out" / "train" / f"00000{k}-camera0") for k in (0, 1))
    assert all(first[name] != second[name] for name in ("frame.exr", "recipe.yaml", "plants.parquet"))
    # The recipe stored beside the second image draws that image again, alone, to the byte.
    again = run("render", tmp_path / "out" / "train" / "000001-camera0" / "recipe.yaml", "-o", tmp_path / "again")
    assert again.code == 0, again.err
    repeated = tree(tmp_path / "again" / "train" / "000001-camera0")
    assert [name for name in second if repeated[name] != second[name]] == []
    assert set(repeated) == set(second)


def test_default_folders_are_new_each_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    recipe = tiny(tmp_path, ("steps: 12", "steps: 1"))
    for _ in range(2):
        assert run("simulate", recipe).code == 0
    assert {path.name for path in (tmp_path / "outputs").iterdir()} == {"tiny-community", "tiny-community-2"}


def test_a_plant_and_its_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import Image

    monkeypatch.chdir(tmp_path)
    answer = run("plant", "fireweed", "--size-px", "48", "64", "--samples", "4")
    assert answer.code == 0, answer.err
    assert set(tree(tmp_path)) == {"outputs", "outputs/fireweed.glb", "outputs/fireweed.png"}
    with Image.open("outputs/fireweed.png") as picture:
        pixels = np.asarray(picture)
    assert pixels.shape == (64, 48, 3)
    green = (pixels[..., 1] > pixels[..., 0]) & (pixels[..., 1] > pixels[..., 2])
    assert green[8:56, 16:32].any()
    for part in ("m tall", "m wide", "triangles", "leaf", "m²", "index", "of wood", "outputs/fireweed.glb"):
        assert part in answer.out


HEIGHTS = [("fireweed", 0.9), ("poplar", 1.0), ("spruce", 2.0)]
TALL = [("fireweed", 1.5), ("poplar", 18.0), ("spruce", 26.0)]


@pytest.mark.parametrize(
    ("species", "height_m"), [*HEIGHTS, *(pytest.param(*one, marks=pytest.mark.slow) for one in TALL)]
)
@pytest.mark.parametrize("suffix", [".glb", ".ply", ".obj"])
def test_a_plant_is_as_tall_as_asked_in_every_format(
    species: str, height_m: float, suffix: str, tmp_path: Path
) -> None:
    import trimesh

    path = tmp_path / f"plant{suffix}"
    answer = run("plant", species, "--height-m", height_m, "--out", path)
    assert answer.code == 0, answer.err
    mesh = trimesh.load(path, force="scene").to_geometry()
    up = 1 if suffix == ".glb" else 2  # glTF is y up
    low, high = mesh.bounds
    assert high[up] == pytest.approx(height_m, rel=0.02)
    assert -0.35 < low[up] <= 0.0  # the foot of a stem reaches into the ground, which may slope
    width = max(high[axis] - low[axis] for axis in range(3) if axis != up)
    assert width < height_m
    said = re.search(r"([\d,]+) triangles", answer.out)
    assert said
    assert len(mesh.faces) == int(said[1].replace(",", ""))
    assert f"{height_m:.2f} m tall" in answer.out
    beside = {one.name for one in tmp_path.iterdir()} - {path.name}
    textures = {name for name in beside if re.fullmatch(r"plant-\w+-(colour|normal)\.png", name)}
    assert beside - textures == ({"plant.mtl"} if suffix == ".obj" else set())
    assert not textures or suffix == ".obj"


def test_a_plants_seed_is_its_own(tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        assert run("plant", "fireweed", "--seed", seed, "-o", tmp_path / f"{name}.ply").code == 0
    a, b, c = ((tmp_path / f"{name}.ply").read_bytes() for name in "abc")
    assert a.split(b"end_header")[1] == b.split(b"end_header")[1] != c.split(b"end_header")[1]


def test_several_plants_are_of_seeds_in_a_row(tmp_path: Path) -> None:
    several = run("plant", "fireweed", "--seed", "7", "--count", "3", "-o", tmp_path / "a.ply")
    assert several.code == 0, several.err
    assert set(tree(tmp_path)) == {"a-0001.ply", "a-0002.ply", "a-0003.ply"}
    assert [line.split()[0] for line in several.out.splitlines()[2:5]] == ["7", "8", "9"]
    assert run("plant", "fireweed", "--seed", "8", "-o", tmp_path / "b.ply").code == 0
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a-0002.ply").read_bytes()


def test_frames_are_one_tree_that_moves(tmp_path: Path) -> None:
    import trimesh

    answer = run("plant", "beech", "--height-m", "2", "--frames", "3", "--frames-per-s", "2", "-o", tmp_path / "s.glb")
    assert answer.code == 0, answer.err
    frames = [trimesh.load(tmp_path / f"s-000{k}.glb", process=False).to_geometry() for k in (1, 2, 3)]
    assert all(np.array_equal(one.faces, frames[0].faces) for one in frames)
    moved = np.linalg.norm(frames[1].vertices - frames[0].vertices, axis=1)
    assert 1e-3 < moved.max() < 0.3
    foot = frames[0].vertices[:, 1] < 0.0
    assert moved[foot].max() < 1e-3


def test_the_list_of_species_grows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    from forestgen.api import plants as single_plant

    monkeypatch.delattr(single_plant, "grow_exemplar")
    answer = run("plant", "--list")
    assert answer.code == 0, answer.err
    lines = answer.out.splitlines()[1:-1]
    rows = {line.split()[0]: line for line in lines if not line.startswith(" ")}  # long descriptions are wrapped
    assert list(rows) == [path.stem for path in sorted(SPECIES.glob("*.yaml"))]
    assert re.fullmatch(r"spruce +\d\d\.\d m +\d\.\d+ m +\w+ +Norway spruce, Picea abies.*", rows["spruce"])


def test_doctor_finds_this_machine_ready() -> None:
    answer = run("doctor")
    assert answer.code == 0, answer.out
    for part in ("Python", "cores", "GB free", "scalar_rgb", "llvm_ad_rgb", "libLLVM", "GPU", "ready to render"):
        assert part in answer.out
    assert not answer.err
    assert re.search(
        r"GPU +(no CUDA driver; not needed|a CUDA driver, but no device; not needed|.*; used if)", answer.out
    )


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        ("import forestgen.render.variant as c; c.find_llvm = lambda: None", "no libLLVM found"),
        ("import os; os.abort()", "crashed with signal 6"),
        ("raise ImportError('no module named mitsuba')", "no module named mitsuba"),
    ],
)
def test_doctor_survives_what_is_broken(broken: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnosis, "_PREPARE", broken)
    answer = run("doctor")
    assert answer.code == 3
    assert said in answer.out
    assert "FAIL  llvm_ad_rgb" in answer.out
    assert "-> install the package karellen-llvm-core" in answer.out
    assert "cannot render here yet" in answer.out
    assert not answer.err


def test_a_render_without_llvm_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from forestgen.render import variant

    variant.mitsuba()  # with the library that there is: it stays that of this process, and other tests use it
    monkeypatch.setattr(variant, "find_llvm", lambda: None)
    answer = run("render", tiny(tmp_path), "-o", tmp_path / "out")
    answer.refused(3)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "verb", ["models", *(pytest.param(one, marks=pytest.mark.slow) for one in ("schema", "doctor"))]
)
def test_a_reader_that_leaves_is_no_error(verb: str) -> None:
    process = start(verb)
    assert process.stdout
    assert process.stderr
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait() == 141
    process.stderr.close()


@pytest.mark.slow
def test_bars_fit_into_a_narrow_terminal(tmp_path: Path) -> None:
    """A terminal of 80 columns, whose bars are drawn over one another and gone from the result's lines."""
    recipe = tiny(tmp_path)
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        command("simulate", recipe, "-o", tmp_path / "out", "--set", "community.steps=300"),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=theirs,
        env={**os.environ, "COLUMNS": "80", "TERM": "xterm"},
    ) as process:
        os.close(theirs)
        shown = b""
        while True:
            try:
                chunk = os.read(ours, 65536)
            except OSError:  # Linux says so when the other end is closed
                break
            if not chunk:
                break
            shown += chunk
        assert process.stdout
        result = process.stdout.read().decode()
        process.terminate()
    os.close(ours)
    assert process.returncode == 0
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode())
    lines = [line.rstrip() for line in re.split(r"[\r\n]+", text)]
    assert any(line.startswith("community") and "301/301" in line for line in lines)
    assert max(map(len, lines)) <= 80
    assert "\x1b" not in result
