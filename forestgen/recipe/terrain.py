"""The recipe's section of the ground's shape."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer, model_validator

from forestgen.recipe.fields import Number, Positive, Section, mistake, spelled_out
from forestgen.recipe.height_map import HIGHEST_M, LOWEST_M, HeightMap


class Terrain(Section):
    """The ground's shape."""

    kind: Annotated[
        Literal["flat", "rolling", "map"], Field(description="Shape of the ground; map: that of a map of heights.")
    ] = "flat"
    amplitude_m: Annotated[
        Number, Field(ge=0, le=500, description="Standard deviation of rolling ground's height, metres.")
    ] = 0.8
    wavelength_m: Annotated[
        Positive, Field(ge=1, le=10000, description="Longest distance between rolling ground's crests, metres.")
    ] = 70.0
    map: Annotated[
        HeightMap | None,
        Field(
            description="Heights over the site, from its north-western corner: a file's name, rows of metres, or a "
            "mapping. GeoTIFF, TIFF, OpenEXR and .npy hold metres, PNG grey levels."
        ),
    ] = None
    lowest_m: Annotated[
        Number | None, Field(ge=LOWEST_M, le=HIGHEST_M, description="Height that black stands for in a map, metres.")
    ] = None
    highest_m: Annotated[
        Number | None, Field(ge=LOWEST_M, le=HIGHEST_M, description="Height that white stands for in a map, metres.")
    ] = None
    fit: Annotated[
        Literal["exact", "stretch"] | None,
        Field(description="exact: a map's cells must be square on the site. Default: exact for files."),
    ] = None

    @field_validator("map", mode="before")
    @classmethod
    def _file_or_rows_alone(cls, value: Any) -> Any:
        return {"rows": value} if isinstance(value, list | tuple) else spelled_out(value, "file")

    @model_validator(mode="after")
    def _map_is_of_its_kind(self) -> Self:
        if (self.kind == "map") != (self.map is not None):
            missing = "map, a file of heights" if self.map is None else "kind: map, where a map is given"
            problem = "terrain of a map without a map" if self.map is None else f"{self.kind} terrain has no map"
            raise mistake(missing, problem=problem, got=self.kind, at=("kind",))
        for key in ("lowest_m", "highest_m", "fit"):
            if self.map is None and getattr(self, key) is not None:
                raise mistake("no such key, or kind: map", problem=f"{self.kind} terrain has no {key}", at=(key,))
        if self.lowest_m is not None and self.highest_m is not None and self.lowest_m >= self.highest_m:
            raise mistake(f"above lowest_m = {self.lowest_m:g} m", got=f"{self.highest_m:g} m", at=("highest_m",))
        return self

    @model_serializer(mode="wrap")
    def _without_what_no_map_needs(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        found: dict[str, Any] = handler(self)
        return {key: value for key, value in found.items() if value is not None}
