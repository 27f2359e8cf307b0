"""Recipes from strangers: refused in plain words, with no file touched that is not theirs, and no memory taken."""

from __future__ import annotations

import hashlib
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from command_line import TINY, command, run
from hostile import FILES, SECRET, SLOTS, TEXTS, WAYS, WRITTEN

from forestgen.core.errors import ForestgenError
from forestgen.recipe.assets import ALLOWED
from forestgen.recipe.load import load_recipe
from forestgen.scene.plan import check_plan
from support.tiers import slow_but

_opened: list[str] = []
_watching: list[bool] = []


def _watch(event: str, arguments: tuple[object, ...]) -> None:
    if event == "open" and _watching:
        _opened.append(os.fsdecode(arguments[0]) if isinstance(arguments[0], str | bytes) else str(arguments[0]))


sys.addaudithook(_watch)  # for good: Python removes none


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A recipe's folder, and beside it one with secrets; whatever is opened meanwhile is written down."""
    (tmp_path / "recipes").mkdir()
    (tmp_path / SECRET).mkdir()
    for suffix in (".yaml", ".lsys", ".csv", ".npy", ".vol", ".nc"):
        (tmp_path / SECRET / f"secret{suffix}").write_text("secret\n")
    monkeypatch.chdir(tmp_path / "recipes")
    monkeypatch.delenv(ALLOWED, raising=False)
    _opened.clear()
    _watching.append(True)
    yield tmp_path / "recipes"
    _watching.clear()


def refused(folder: Path, text: str) -> ForestgenError:
    """How the recipe is refused; nothing lies in its folder that it did not bring, and nothing outside was opened."""
    (folder / "r.yaml").write_text(text)
    before, began = sorted(folder.rglob("*")), time.process_time()
    with pytest.raises(ForestgenError) as caught:
        check_plan(load_recipe(folder / "r.yaml"))
    assert time.process_time() - began < 30  # a bomb takes hours; this machine may be busy
    assert caught.value.exit_code in (2, 3)
    message = str(caught.value)
    assert all(one == "\n" or one.isprintable() for one in message)
    assert len(message) < 20_000
    assert "secret\n" not in message
    assert sorted(folder.rglob("*")) == before
    assert not [path for path in _opened if f"/{SECRET}/" in os.path.realpath(path)]
    return caught.value


def leads_out(folder: Path, slot: str, way: str) -> None:
    text, suffix = SLOTS[slot]
    written = WAYS[way](folder, f"secret{suffix}")
    assert "leads out of the recipe's folder" in str(refused(folder, text.replace("PATH", f"'{written}'")))


@pytest.mark.parametrize("slot", SLOTS)
def test_no_path_leaves_the_recipes_folder(slot: str, folder: Path) -> None:
    leads_out(folder, slot, "by a linked folder")


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("slot", ["density", *(pytest.param(one, marks=pytest.mark.slow) for one in SLOTS)])
def test_in_no_way(slot: str, way: str, folder: Path) -> None:
    leads_out(folder, slot, way)


@pytest.mark.parametrize("written", WRITTEN)
def test_paths_that_are_refused_as_they_are_written(written: str, folder: Path) -> None:
    for slot in ("species", "density"):
        quoted = '"' + written.replace("\\", "\\\\").replace("\t", "\\t").replace("\n", "\\n") + '"'
        refused(folder, SLOTS[slot][0].replace("PATH", quoted))
    assert not [path for path in _opened if path.startswith(("/etc", "/dev/zero", "/proc/self/environ", "//"))]


def test_a_species_file_leaves_no_folder_either(folder: Path) -> None:
    (folder / "sub").mkdir()
    species = "plant: {generator: lsystem, program: ../../outside/secret.lsys}\n"
    (folder / "sub" / "own.yaml").write_text(species)
    text = SLOTS["species"][0].replace("PATH", "sub/own.yaml")
    assert "leads out of the recipe's folder" in str(refused(folder, text))
    (folder / "sub" / "own.yaml").write_text(species.replace("../../outside", "../outside"))  # in the recipe's folder
    assert "no such lsystems file" in str(refused(folder, text))


def density(folder: Path, name: str) -> str:
    """A recipe of an array that lies there."""
    np.save(folder / name, np.ones((5, 6)))
    return SLOTS["density"][0].replace("PATH", name)


def test_the_recipes_own_files_and_links_within_it_are_read(folder: Path) -> None:
    (folder / "maps").mkdir()
    text = density(folder, "maps/own.npy")
    (folder / "link.npy").symlink_to("maps/own.npy")
    for written in ("maps/own.npy", "./maps/../maps/own.npy", "../recipes/maps/own.npy", "link.npy"):
        (folder / "r.yaml").write_text(text.replace("maps/own.npy", written))
        assert check_plan(load_recipe(folder / "r.yaml"))


def test_a_folder_that_the_user_allows(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(folder.parent / SECRET / "own.npy", np.ones((5, 6)))
    monkeypatch.setenv(ALLOWED, "")
    for written in (f"../{SECRET}/own.npy", str(folder.parent / SECRET / "own.npy")):
        (folder / "r.yaml").write_text(SLOTS["density"][0].replace("PATH", written))
        answer = run("validate", folder / "r.yaml")
        answer.refused(2, "r.yaml:5: community.plants.fireweed.map", "--allow-folder DIR")
        assert run("--allow-folder", folder.parent / SECRET, "validate", folder / "r.yaml").code == 0
        monkeypatch.setenv(ALLOWED, os.pathsep.join(["/nowhere", str(folder.parent / SECRET)]))
        assert run("validate", folder / "r.yaml").code == 0
        monkeypatch.setenv(ALLOWED, "")
    run("--allow-folder", folder / "nowhere", "validate", folder / "r.yaml").refused(2)


def test_an_images_recipe_reads_the_maps_beside_it_by_their_content(folder: Path) -> None:
    frame, maps = folder / "data" / "000000-camera0", folder / "data" / "maps"
    frame.mkdir(parents=True)
    maps.mkdir()
    np.save(maps / "x.npy", np.ones((5, 6)))
    sha256 = hashlib.sha256((maps / "x.npy").read_bytes()).hexdigest()
    stored = maps / f"{sha256[:16]}.npy"
    (maps / "x.npy").rename(stored)
    text = SLOTS["density"][0]

    def written(path: str, digest: str | None) -> str:
        return text.replace("PATH", f"{{file: {path}" + (f", sha256: {digest}}}" if digest else "}"))

    (frame / "r.yaml").write_text(written(f"../maps/{stored.name}", sha256))
    assert check_plan(load_recipe(frame / "r.yaml"))
    for path, digest in (
        (f"../maps/{stored.name}", None),  # not told by its content
        (f"../maps/{stored.name}", hashlib.sha256(b"other").hexdigest()),
        (f"./../maps/{stored.name}", sha256),
        ("../maps/secret.npy", sha256),
        (f"../../maps/{stored.name}", sha256),
    ):
        refused(frame, written(path, digest))
    _opened.clear()
    stored.rename(folder.parent / SECRET / stored.name)
    stored.symlink_to(folder.parent / SECRET / stored.name)
    assert "leads out" in str(refused(frame, written(f"../maps/{stored.name}", sha256)))


@pytest.mark.parametrize("name", slow_but(TEXTS, *(name for name in TEXTS if name != "species without end")))
def test_a_hostile_recipe_is_refused(name: str, folder: Path) -> None:
    refused(folder, TEXTS[name])


@pytest.mark.parametrize("name", FILES)
def test_a_hostile_file_is_refused(name: str, folder: Path) -> None:
    slot, suffix, write = FILES[name]
    write(folder / f"own{suffix}", folder.parent / SECRET / "secret.nc")
    text = SLOTS[slot][0].replace("PATH", f"own{suffix}")
    if slot == "weather":  # such fields are read when the picture is made
        (folder / "r.yaml").write_text(text)
        with pytest.raises(ForestgenError) as caught:
            _read_weather(folder)
        assert caught.value.exit_code in (2, 3)
        assert not [path for path in _opened if f"/{SECRET}/" in os.path.realpath(path)]
    else:
        refused(folder, text)


def _read_weather(folder: Path) -> None:
    from forestgen.atmosphere.weather_files import read_sky

    plan = check_plan(load_recipe(folder / "r.yaml"))
    named = plan.drawn.recipe.sky.clouds.file
    assert named is not None
    read_sky(folder / named.file)


def test_the_tiny_recipe_itself_is_fine(folder: Path) -> None:
    """What the others are made from: none of them is refused for another reason than its own."""
    (folder / "r.yaml").write_text(TINY)
    assert check_plan(load_recipe(folder / "r.yaml"))


_EXTRA_S, _EXTRA_BYTES = 5.0, 500_000_000


@pytest.fixture(scope="module")
def plain_mistake(tmp_path_factory: pytest.TempPathFactory) -> tuple[float, int]:
    """What the command takes for a recipe whose map is missing."""
    folder = tmp_path_factory.mktemp("plain") / "recipes"
    folder.mkdir()
    return measured(folder, SLOTS["density"][0].replace("PATH", "nix.npy"))


@pytest.mark.slow
@pytest.mark.parametrize("name", [*TEXTS, *FILES])
def test_a_command_refuses_it_soon_and_takes_no_memory(
    name: str, folder: Path, plain_mistake: tuple[float, int]
) -> None:
    """As a user meets it, against what the same command takes for a recipe with a plain mistake."""
    text = TEXTS.get(name)
    if text is None:
        slot, suffix, write = FILES[name]
        write(folder / f"own{suffix}", folder.parent / SECRET / "secret.nc")
        text = SLOTS[slot][0].replace("PATH", f"own{suffix}")
    taken_s, taken_bytes = measured(folder, text)
    assert taken_s - plain_mistake[0] < 2 * _EXTRA_S  # of processor time, which a busy machine stretches
    assert taken_bytes - plain_mistake[1] < _EXTRA_BYTES


def measured(folder: Path, text: str) -> tuple[float, int]:
    """Processor time and peak memory of ``forestgen render``, which must refuse."""
    (folder / "r.yaml").write_text(text)
    before = sorted(folder.parent.rglob("*"))
    program = (
        "import resource, subprocess, sys\n"
        "done = subprocess.run(sys.argv[1:], capture_output=True, text=True, timeout=120)\n"
        "used = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "print(done.returncode, used.ru_utime + used.ru_stime, used.ru_maxrss)\n"
        "print(done.stderr)"
    )
    arguments = command("render", folder / "r.yaml", "-o", folder.parent / "out")
    found = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=True)
    first, _, message = found.stdout.partition("\n")
    code, seconds, kilobytes = first.split()
    assert int(code) in (2, 3), message
    assert message.startswith("error: ")
    assert "Traceback" not in message
    assert "a bug in forestgen" not in message
    assert sorted(folder.parent.rglob("*")) == before
    return float(seconds), 1024 * int(kilobytes)


def test_the_measure_measures() -> None:
    """What a child takes is told in the units that are assumed."""
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 > 10_000_000
