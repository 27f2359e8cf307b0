"""Maps of density: a picture or an array over the site.

::

    map: meadow.png                      # beside the recipe; PNG, TIFF, OpenEXR or .npy
    map: [[0, 1], [1, 0.5]]              # values row by row, from north to south
    map: {file: meadow.png, invert: true, scale: 250, fit: stretch, smooth: false}

A picture's first row is the northern edge, its left column the western one. Integer pictures go from 0 (black) to 1
(white, the largest value of their type); floating point ones and arrays keep their values, so that plants per hectare
may be painted, with ``plants_per_ha: 1``. Colour counts by the luminance of its stored values, transparency as black.

A map is a function over the site: constant in each pixel or, `smooth`, straight between the middles of pixels and
constant beyond the outermost. A cell's value is the mean of that function over the cell, so that the integral over the
site is the map's on every grid. Where cells are larger than pixels it is the pixels' mean in either case.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    PrivateAttr,
    ValidationInfo,
    model_validator,
)
from pydantic_core import core_schema

from forestgen.community.population import Floats
from forestgen.core.cache import BoundedCache
from forestgen.core.errors import AssetError, RecipeError
from forestgen.core.raster import SingleChannelRaster, read_raster
from forestgen.recipe.assets import inside
from forestgen.recipe.fields import Flag, NonNegative, Positive, Section, Text, violation
from forestgen.recipe.map_files import file_sha256
from forestgen.recipe.sources import Keys

if TYPE_CHECKING:
    from scipy.sparse import csc_array

_ROWS_AT_ONCE = 256
LARGEST = 1e12  # a map's values, scaled; more would make sums over the site meaningless
LEAST = 1e-100  # what is less counts as 0: its square, and what it divides, must still be numbers

_pictures: BoundedCache[SingleChannelRaster] = BoundedCache(400_000_000, lambda one: one.values.nbytes)
_grids: BoundedCache[Floats] = BoundedCache(200_000_000, lambda one: one.nbytes)


def resample(
    stored: NDArray[Any], values_of: Callable[[NDArray[Any]], Floats], shape: tuple[int, int], *, smooth: bool
) -> Floats:
    """(rows, cols) float64 means in the cells of a grid of `shape`, of the same mean as the pixels.

    `stored` (rows, cols) is turned into numbers by `values_of`, a block of rows at a time. If `smooth`, values run
    straight between the middles of pixels along an axis that has more cells than pixels; else, and without it, they are
    constant in each pixel.
    """
    across = _weights(stored.shape[1], shape[1], smooth).tocsr()
    along = _weights(stored.shape[0], shape[0], smooth)
    out = np.zeros(shape)
    for start in range(0, stored.shape[0], _ROWS_AT_ONCE):
        stop = min(start + _ROWS_AT_ONCE, stored.shape[0])
        block = (across @ values_of(stored[start:stop]).T).T
        share = along[:, start:stop]
        reached = slice(int(share.indices.min()), int(share.indices.max()) + 1)
        out[reached] += share.tocsr()[reached] @ np.ascontiguousarray(block)
    return out


def _weights(pixels: int, cells: int, smooth: bool) -> csc_array:
    """(cells, pixels) sparse: each cell's mean as a weighted sum of pixels, along one axis.

    Between all edges of cells and all edges (or middles) of pixels the function is straight, so that its mean there is
    its value halfway.
    """
    from scipy.sparse import csc_array  # slow to import

    straight = smooth and cells > pixels
    # An edge of both grids is the same float in both: i * pixels / cells is exact where it is whole.
    edges = np.arange(cells + 1) * pixels / cells
    bends = np.arange(pixels) + 0.5 if straight else np.arange(1, pixels, dtype=np.float64)
    ends = np.union1d(edges, bends)
    middle, length = (ends[1:] + ends[:-1]) / 2, np.diff(ends)
    cell = np.searchsorted(edges, middle, side="right") - 1
    share = length * cells / pixels
    if not straight:
        pixel = np.floor(middle).astype(np.int64)
        return csc_array((share, (cell, pixel)), shape=(cells, pixels))
    lower = np.floor(middle - 0.5).astype(np.int64)
    upper_share = (middle - 0.5 - lower) * share
    pairs = np.clip(np.concatenate([lower, lower + 1]), 0, pixels - 1)
    weights = np.concatenate([share - upper_share, upper_share])
    return csc_array((weights, (np.concatenate([cell, cell]), pairs)), shape=(cells, pixels))


def _spelled_out(value: Any) -> Any:
    if isinstance(value, str):
        return {"file": value}
    if isinstance(value, list | tuple):
        return {"rows": value}
    if not isinstance(value, Mapping | BaseModel):
        raise violation("a file's name, rows of numbers, or a mapping of keys such as file and scale")
    return value


class MapSection(Section):
    """A map; its first row is the northern edge, as in a picture, and it covers the whole site."""

    # The content tells which map it is, not its place: what is dumped, such as a history's origin, is the same for all
    # copies of a recipe.
    file: Text | None = Field(
        None, exclude=True, description="Path of a PNG, TIFF, OpenEXR or .npy file, relative to the recipe's folder."
    )
    sha256: Annotated[Text, Field(pattern="^[0-9a-f]{64}$")] | None = Field(
        None, description="SHA-256 of the file; no file of other content is taken."
    )
    rows: tuple[tuple[NonNegative, ...], ...] | None = Field(
        None, description="Instead of a file: its values, row by row from north to south."
    )
    scale: Positive = Field(1.0, le=LARGEST, description="What its values are multiplied by.")
    invert: Flag = Field(False, description="Whether 1 minus each value counts, before it is scaled.")
    fit: Literal["exact", "stretch"] | None = Field(
        None, description="exact: its pixels must be square on the site. Default: exact for a file, stretch for rows."
    )
    smooth: Flag = Field(True, description="Whether values are interpolated between the middles of pixels.")

    _picture: SingleChannelRaster = PrivateAttr()

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Self:
        if hasattr(self, "_picture"):  # part of other parameters now, without its recipe's folder
            return self
        if (self.file is None) == (self.rows is None):
            problem = "the map has neither file nor rows" if self.file is None else "the map has both file and rows"
            raise violation("one of them", problem=problem)
        if self.rows is not None:
            _check_rows(self.rows)
            self._picture = SingleChannelRaster(np.array(self.rows, dtype=np.float64), 1.0)
        else:
            self._picture = self._opened((info.context or {}).get("folder"))
        self._check_values()
        return self

    def _opened(self, folder: Path | None) -> SingleChannelRaster:
        """The file's picture, read once for all maps of its content; without a recipe's folder, of any path."""
        assert self.file is not None
        named = self.file
        try:
            path = Path(named) if folder is None else inside(folder, named, sha256=self.sha256)
        except AssetError as cause:
            raise violation(cause.expected or "", problem=cause.problem, got=cause.got, hint=cause.hint) from cause

        def read() -> SingleChannelRaster:
            if self.sha256 is not None and file_sha256(path, named) != self.sha256:
                problem = "this is not the file that the recipe was made with"
                raise AssetError(problem, expected=f"a file whose SHA-256 is {self.sha256[:16]}...", got=str(path))
            return read_raster(path)

        try:
            return _pictures.get(self.sha256 or file_sha256(path, named), read)
        except AssetError as cause:
            got = str(path) if cause.got is None else cause.got if named in cause.got else f"{named}: {cause.got}"
            raise violation(cause.expected or "a map", problem=cause.problem, got=got, hint=cause.hint) from cause

    def _check_values(self) -> None:
        picture, name = self._picture, self.file or "the rows"
        low, high = picture.lowest, picture.highest
        largest = high * self.scale
        if not (np.isfinite(low) and np.isfinite(high)):
            where = _first(picture, ~np.isfinite(picture.values))
            raise violation("finite numbers", problem="not every value of the map is a number", got=f"{name}: {where}")
        if low < 0:
            where = _first(picture, picture.values < 0)
            raise violation(
                "values of at least 0", problem="the map has negative values", got=f"{name}: {where}", hint="clip them"
            )
        for wrong, expected, problem, got in (
            (self.invert and high > 1, "values of at most 1", "only values from 0 to 1 can be inverted", "up to "),
            (0 < largest < LEAST, f"a value of at least {LEAST:g}", "the map's values are too small", ""),
            (largest > LARGEST, f"values of at most {LARGEST:g}", "the map's values are too large", ""),
        ):
            if wrong:
                raise violation(expected, problem=problem, got=f"{name}: {got}{high:g}")

    @property
    def shape(self) -> tuple[int, int]:
        """Its rows and columns."""
        rows, cols = self._picture.values.shape
        return rows, cols

    @property
    def is_zero(self) -> bool:
        """Whether it is 0 everywhere."""
        return self._picture.lowest == 1 if self.invert else self._picture.highest == 0

    def values(self) -> Floats:
        """(rows, cols) float64 of its pixels, row 0 at y = 0."""
        return self._final(np.ascontiguousarray(self._picture.values[::-1]))

    def _final(self, stored: NDArray[Any]) -> Floats:
        """What stored values mean."""
        values = stored.astype(np.float64) / self._picture.white
        return np.asarray((1.0 - values if self.invert else values) * self.scale)

    def on_grid(self, shape: tuple[int, int]) -> Floats:
        """(rows, cols) float64: the map's mean in each cell of a grid over the site, row 0 at y = 0."""
        return self._on_grid(shape, "smooth" if self.smooth else "plain", self._final)

    def any_above_zero(self, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """(rows, cols) bool: whether any part of a pixel above 0 lies in the cell, row 0 at y = 0.

        Pixels count as squares, `smooth` or not: where a mask bars, no plant's centre may lie on a barred pixel.
        """
        return self._on_grid(shape, "mask", lambda stored: (self._final(stored) > 0).astype(np.float64)) > 0

    def _on_grid(self, shape: tuple[int, int], what: str, values_of: Callable[[NDArray[Any]], Floats]) -> Floats:
        def make() -> Floats:
            # The view's first row is the southern one.
            return resample(self._picture.values[::-1], values_of, shape, smooth=what == "smooth")

        if self.sha256 is None:
            return make()
        # A plan, a placement and its pictures ask for the same grids, some of them many times.
        return _grids.get((self.sha256, self.scale, self.invert, what, *shape), make).copy()


def _check_rows(rows: tuple[tuple[float, ...], ...]) -> None:
    if not rows or not rows[0]:
        raise violation("at least one row of at least one value", problem="the map has no values")
    for index, row in enumerate(rows):
        if len(row) != len(rows[0]):
            expected = f"{len(rows[0])} values, as in the first row"
            raise violation(expected, problem="the map's rows differ in length", got=f"{len(row)} in row {index + 1}")


def _first(picture: SingleChannelRaster, wrong: NDArray[np.bool_]) -> str:
    """The first of the wrong values, for people."""
    row, col = np.argwhere(wrong)[0]
    count = int(wrong.sum())
    more = f", and {count - 1:,} more" if count > 1 else ""
    return f"{picture.values[row, col]:g} in row {row + 1}, column {col + 1}{more}"


class _ShortForms:
    """Admits a file's name and plain rows into the JSON Schema."""

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        rows = {"type": "array", "minItems": 1, "items": {"type": "array", "items": {"type": "number", "minimum": 0}}}
        name = {"type": "string", "description": "Path of a PNG, TIFF, OpenEXR or .npy file."}
        return {"anyOf": [name, rows, handler(schema)]}


DensityMap = Annotated[MapSection, BeforeValidator(_spelled_out), _ShortForms()]


def maps_in(value: Any, keys: Keys = ()) -> Iterator[tuple[Keys, MapSection]]:
    """Key path and map, of all maps in a model's parameters."""
    inner: Iterable[tuple[Any, Any]] = ()
    if isinstance(value, MapSection):
        yield keys, value
    elif isinstance(value, BaseModel):
        inner = ((name, getattr(value, name)) for name in type(value).model_fields)
    elif isinstance(value, Mapping | list | tuple):
        inner = value.items() if isinstance(value, Mapping) else enumerate(value)
    for key, item in inner:
        yield from maps_in(item, (*keys, key))


def check_maps(parameters: BaseModel, size_m: tuple[float, float], where: Callable[..., str]) -> None:
    """Raise `RecipeError` for a density that is 0 everywhere, or pixels not square on the site of a map not to stretch.

    `size_m` is the site's; `where` gives the place of a key path of the parameters.
    """
    for keys, one in maps_in(parameters):
        if one.is_zero and keys[-1] not in ("keep_out", "soil"):
            problem, expected = "the map is 0 everywhere", "a value above 0, where plants may stand"
            hint = "invert: false" if one.invert else None
            raise RecipeError(problem, where=where(*keys), expected=expected, got=one.file or "rows of 0", hint=hint)
        exact = one.fit == "exact" or (one.fit is None and one.file is not None)
        if exact and not _square(one.shape, size_m):
            problem = "the map's shape is not the site's"
            expected = f"{_shape_of(size_m, one.shape)}, for a site of {size_m[0]:g} x {size_m[1]:g} m"
            got = f"{one.shape[1]} x {one.shape[0]} pixels"
            raise RecipeError(problem, where=where(*keys), expected=expected, got=got, hint="fit: stretch")


def _square(shape: tuple[int, int], size_m: tuple[float, float]) -> bool:
    """Whether pixels are square on the site but for rounding one side to whole pixels, up or down."""
    (rows, cols), (width, height) = shape, size_m
    return abs(cols - rows * width / height) < 1 or abs(rows - cols * height / width) < 1


def _shape_of(size_m: tuple[float, float], shape: tuple[int, int]) -> str:
    """The shape a map should have, for people: ``3:2 such as 768 x 512 pixels``."""
    (rows, cols), (width, height) = shape, size_m
    wider = round(rows * width / height)
    wanted = (wider, rows) if wider > cols else (cols, max(1, round(cols * height / width)))
    ratio = Fraction(width / height).limit_denominator(100)
    plain = ratio > 0 and abs(float(ratio) * height / width - 1) < 1e-6
    such = f"{wanted[0]} x {wanted[1]} pixels"
    return f"{ratio.numerator}:{ratio.denominator} such as {such}" if plain else such
