"""What is read of a recipe before the schema sees it: its file's name, its version, and all that it draws."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from forestgen.core.errors import AssetError, RecipeError
from forestgen.recipe.assets import list_assets, recipes_dir
from forestgen.recipe.dataset import DEFAULT_SPLITS
from forestgen.recipe.draws import MOST_PROBES, Draws, find_written, parsed
from forestgen.recipe.messages import Explainer, show
from forestgen.recipe.sampler import Sampler, make_sampler
from forestgen.recipe.sampling import Sampling
from forestgen.recipe.schema import SCHEMA_VERSION
from forestgen.recipe.sources import SourceMap
from forestgen.recipe.variables import is_reference, make_variables


def make_draws(data: Mapping[str, Any], sources: SourceMap) -> Draws:
    """All that is drawn, checked."""
    section = _sampling(data, sources)
    written, seed = find_written(data), whole_number(data, "seed", 0)
    distributions = parsed(written, sources)
    references = {keys: value for keys, value in written.items() if is_reference(value)}
    given = section.variables if section is not None else {}
    variables = make_variables(given, references, distributions, sources)
    sampler: Sampler | None = None
    if section is not None:
        sampler = make_sampler(section, distributions, references, sources, seed, splits_of(data))
    draws = Draws(seed, written, distributions, variables, sampler)
    if draws.probe_count > MOST_PROBES:
        raise RecipeError(
            "the recipe draws too much to be checked",
            where=sources.where(()),
            expected=f"at most {MOST_PROBES:,} ends of distributions and choices in all",
            got=f"{draws.probe_count:,}",
        )
    return draws


def _sampling(data: Mapping[str, Any], sources: SourceMap) -> Sampling | None:
    """The section of the name, which decides how all the others are drawn."""
    written = data.get("sampling")
    if written is None:
        return None
    try:
        return Sampling.model_validate(written)
    except ValidationError as failure:
        given = written if isinstance(written, dict) else {}
        raise Explainer(Sampling, given, sources, ("sampling",)).error(failure) from None


def suggest_shipped(path: Path) -> None:
    """A missing file that looks like a shipped recipe's name is met with that recipe's path."""
    name = path.name.removesuffix(".yaml")
    try:
        if path.exists():
            return
    except (OSError, ValueError) as cause:
        raise AssetError("not a file's name", where=f"{str(path)!r:.80}", expected="a recipe's path") from cause
    names = list_assets("recipes")
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"a recipe comes with forestgen: {recipes_dir() / near[0]}.yaml" if near else None
    raise AssetError("no such recipe", where=str(path), expected="the path of a YAML file", got="no file", hint=hint)


def check_version(data: Mapping[str, Any], sources: SourceMap) -> None:
    version = data.get("forestgen")
    if version == SCHEMA_VERSION and not isinstance(version, bool):
        return
    got = show(version) if "forestgen" in data else "no such key"
    newer = isinstance(version, int) and version > SCHEMA_VERSION
    raise RecipeError(
        "unknown version of the recipe's schema",
        where=sources.where(("forestgen",)),
        expected=f"forestgen: {SCHEMA_VERSION}",
        got=got,
        hint="this recipe is for a newer forestgen" if newer else f"write 'forestgen: {SCHEMA_VERSION}' at the top",
    )


def whole_number(data: Mapping[str, Any], key: str, default: int) -> int:
    """A whole number needed before validation; a bad one counts as the default until validation rejects it."""
    value = data.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 2**63:
        return default
    return int(value)


def splits_of(data: Mapping[str, Any]) -> Mapping[str, float]:
    """Splits are needed before validation, too; bad ones count as the default until validation rejects them."""
    section = data.get("dataset")
    splits = section.get("splits") if isinstance(section, Mapping) else None
    shares = list(splits.values()) if isinstance(splits, Mapping) else []
    good = all(isinstance(one, int | float) and not isinstance(one, bool) and 0 < one < 1e100 for one in shares)
    return {str(name): float(share) for name, share in splits.items()} if splits and shares and good else DEFAULT_SPLITS
