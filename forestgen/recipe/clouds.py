"""The recipe's section of clouds: its source, which has all other keys. A source is a part; see atmosphere/clouds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from forestgen.recipe.fields import PartSection, Section, Text
from forestgen.recipe.registries import CLOUD_SOURCES

FileName = Annotated[Text, Field(min_length=1, max_length=4000)]
Sha256 = Annotated[Text, Field(pattern="^[0-9a-f]{64}$")]


class GivenSection(Section):
    """A section whose keys may all be left out; it is written down as it was given."""

    @model_serializer(mode="wrap")
    def _as_given(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in handler(self).items() if value is not None}


class NamedFile(GivenSection):
    """A file beside the recipe, known by its content."""

    file: FileName = Field(description="Its path, relative to the recipe's folder.")
    sha256: Sha256 | None = Field(
        default=None, description="SHA-256 of its content, written when the recipe is loaded; another file is refused."
    )


class Clouds(PartSection, GivenSection):
    """The clouds above the site, or around it."""

    registry = CLOUD_SOURCES
    selector = "type"
    has_clouds: ClassVar[bool] = True  # whether there are ever any

    type: Text = Field(default="none", description="Where the clouds come from.")

    @property
    def known_cover(self) -> float | None:
        """Share of the sky's area under cloud, where the recipe itself says it."""
        return None

    @classmethod
    def named_by(cls, data: Mapping[str, Any]) -> Any:
        """The type; of a story its first chapter's."""
        story = data.get("story")
        if data.get("type") is None and isinstance(story, list | tuple) and story and isinstance(story[0], Mapping):
            return story[0].get("type", cls.model_fields["type"].default)
        return super().named_by(data)
