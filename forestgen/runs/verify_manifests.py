"""The files that describe others: dataset.json, the splits' manifest.json, the recipe."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from forestgen.core.errors import ForestgenError
from forestgen.dataset.card import CARD_NAME
from forestgen.dataset.check.files import read_json, read_text
from forestgen.dataset.check.finding import MISUNDERSTOOD, Finding, UnreadableError, misunderstood
from forestgen.dataset.index import INDEX_NAME
from forestgen.dataset.manifest import MANIFEST_NAME
from forestgen.recipe.dataset import split_of
from forestgen.recipe.load import load_recipe
from forestgen.recipe.map_files import recipe_hash
from forestgen.runs.description import DATASET_NAME, file_groups
from forestgen.runs.ledger import Ledger

_NOT_COUNTED = (DATASET_NAME, INDEX_NAME, CARD_NAME)  # in dataset.json's groups of files: they are written after it


def manifest_findings(
    root: Path, split: str, said: Mapping[str, Any], ledger: Ledger, seeds: Mapping[int, int]
) -> Iterator[Finding]:
    """What is wrong in a split's manifest.json.

    Parameters
    ----------
    said : dataset.json.
    ledger : with the files of SHA256SUMS.
    seeds : image -> seed, by the index, of the split's images.
    """
    name = f"{split}/{MANIFEST_NAME}"
    try:
        manifest = read_json(root, name)
        listed = {f"{split}/{path}": entry["sha256"] for path, entry in manifest["files"].items()}
        recipes = [{"hash": one["hash"], "root_seed": one["root_seed"]} for one in said["recipes"]]
        wanted = {"split": split, "recipes": recipes, "image_seeds": [seeds[image] for image in sorted(seeds)]}
        for key, value in wanted.items():
            if manifest.get(key) != value:
                got = f"{manifest.get(key)!r:.120}"
                yield Finding(name, f"{key} is not the index's or dataset.json's", f"{value!r:.120}", got)
    except UnreadableError as error:
        yield error.finding
        return
    except MISUNDERSTOOD as error:
        yield misunderstood(name, error)
        return
    for path, digest in listed.items():
        known = ledger.file(path)
        if known is None or known.sha256 != digest:
            got = "not listed" if known is None else f"sha256 {known.sha256}"
            yield Finding(path, f"SHA256SUMS and {name} disagree", f"sha256 {digest}", got)
    for file in ledger.files(split):
        if file.path not in listed and file.path != name:
            yield Finding(file.path, f"{name} does not list this file", "its bytes and SHA-256", "none")


def description_findings(said: Mapping[str, Any], split_of_image: Mapping[int, str]) -> Iterator[Finding]:
    """What is wrong in dataset.json.

    Parameters
    ----------
    split_of_image : image -> split, by the index.
    """
    for key in ("images", "frames"):
        total = sum(int(counts[key]) for counts in said["splits"].values())
        if said[key] != total:
            yield Finding(DATASET_NAME, f"{key} is not the sum over the splits", str(total), str(said[key]))
    made = dict.fromkeys(range(len(said["recipes"])), 0)
    for image, split in split_of_image.items():
        number = next((at for at, one in enumerate(said["recipes"]) if _holds(one["asked"], image)), None)
        if number is None:
            yield Finding(DATASET_NAME, f"image {image} of the index is of no recipe", "one that asked for it", "none")
            continue
        made[number] += 1
        shares = said["recipes"][number]["splits"]
        if shares and split_of(shares, image) != split:
            problem = f"image {image} is in another split than its number gives"
            yield Finding(INDEX_NAME, problem, split_of(shares, image), split, image=str(image))
    for number, count in made.items():
        one = said["recipes"][number]
        asked, missing = (sum(last - first + 1 for first, last in one[key]) for key in ("asked", "missing"))
        if (one["images"], missing) != (asked, asked - count):
            expected, got = f"{asked} asked, {asked - count} missing", f"{one['images']} asked, {missing} missing"
            yield Finding(DATASET_NAME, f"recipes[{number}] counts its images wrongly", expected, got)


def group_findings(said: Mapping[str, Any], ledger: Ledger) -> Iterator[Finding]:
    """Kinds of files that dataset.json counts otherwise; of a data set in which no file is missing or added."""
    there = file_groups(file for file in ledger.present() if file.path not in _NOT_COUNTED)
    for group in sorted({*there, *said["files"]}):
        if there.get(group) != said["files"].get(group):
            expected, got = str(there.get(group)), str(said["files"].get(group))
            yield Finding(DATASET_NAME, f"files: {group} is counted wrongly", expected, got)


def recipe_findings(root: Path, said: Mapping[str, Any]) -> Iterator[Finding]:
    """Recipes of the whole data set that do not have the hash of dataset.json."""
    for one in said["recipes"]:
        file = str(one["file"])
        try:
            content = plain_yaml(read_text(root, file), file)
            digest = _identity(content)
            if digest != one["hash"]:  # maps that are drawn from a list have no sums in the file: the loader adds them
                digest = _identity(load_recipe(root / file).complete)
        except UnreadableError as error:
            yield error.finding
        except ForestgenError as error:
            yield Finding(
                file, "the recipe has changed, and cannot be loaded", one["hash"], " ".join(str(error).split())
            )
        else:
            if digest != one["hash"]:
                yield Finding(file, "the recipe is not the one that dataset.json names", one["hash"], digest)


def plain_yaml(text: str, name: str) -> dict[str, Any]:
    """A recipe's content without the loader's checks; `UnreadableError` if it is no mapping."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        content = YAML(typ="safe").load(text)
    except (YAMLError, ValueError, RecursionError) as error:
        got = " ".join(str(error).split())[:200]
        raise UnreadableError(Finding(name, "the file cannot be read", got=got)) from error
    if not isinstance(content, dict):
        raise UnreadableError(Finding(name, "this is no recipe", expected="a mapping"))
    return content


def _identity(complete: Mapping[str, Any]) -> str:
    return recipe_hash({key: value for key, value in complete.items() if key not in ("images", "first_image")})


def _holds(ranges: Any, image: int) -> bool:
    return any(first <= image <= last for first, last in ranges)
