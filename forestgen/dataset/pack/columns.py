"""Columns of a Hugging Face data set: their type in Arrow, in the library's own JSON, and in a README's YAML.

The library keeps its types as JSON in a Parquet file's metadata, so that a column of pictures opens as pictures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from forestgen.dataset.formats.shards import json_text
from forestgen.dataset.pack.channels import Channel
from forestgen.dataset.pack.samples import Sample
from forestgen.dataset.pack.source import Source
from forestgen.dataset.safe_path import load_json

# Of the index, what each frame's columns say in another way.
_LEFT_OUT = ("frame", "folder", "split")
_RENAMED = {"image": "image_number"}  # `image` is the picture

# Field of `objects` -> type, and the annotation's key: lists with a value a plant in view.
_OBJECT_FIELDS = {
    "plant_id": ("int64", "plant_id"),
    "area": ("int64", "area"),
    "truncated": ("bool", "truncated"),
    "species": ("string", "species"),
    "distance_m": ("float64", "distance_m"),
    "height_m": ("float64", "height_m"),
    "visible_fraction": ("float64", "visible_fraction"),
    "amodal_area": ("int64", "amodal_area"),
}


@dataclass(frozen=True)
class Column:
    """A column."""

    name: str
    feature: Any  # as the library writes it to JSON
    cell: Callable[[Sample], Any]  # plain value of a frame


def columns_of(source: Source, channels: Sequence[Channel]) -> list[Column]:
    """All columns of a pack: the channels', the camera, what the index says."""
    categories = list(source.classes["categories"].values())
    columns = [Column("frame", value("string"), lambda sample: sample.name)]
    columns += [_of_channel(channel, categories) for channel in channels]
    columns.append(Column("camera_parameters", value("string"), _camera_text))
    if any(channel.name == "depth" for channel in channels):
        columns.append(Column("depth_unit_m", value("float64"), lambda sample: sample.depth_unit_m))
    return columns + _of_index(source)


def value(dtype: str) -> dict[str, Any]:
    return {"dtype": dtype, "_type": "Value"}


def sequence(feature: Any) -> dict[str, Any]:
    """A list; by the older of its two names, which every version of the library knows."""
    return {"feature": feature, "_type": "Sequence"}


def arrow_type(feature: Any) -> Any:
    """Type in which a feature is stored."""
    import pyarrow as pa

    kind = feature.get("_type") if isinstance(feature.get("_type"), str) else None
    if kind is None:
        return pa.struct([(name, arrow_type(one)) for name, one in feature.items()])
    if kind == "Image":
        return pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    if kind == "Sequence":
        return pa.list_(arrow_type(feature["feature"]))
    if kind == "ClassLabel":
        return pa.int64()
    return pa.type_for_alias(feature["dtype"])


def yaml_type(feature: Any) -> dict[str, Any]:
    """The feature as a README's `dataset_info` has it."""
    kind = feature.get("_type") if isinstance(feature.get("_type"), str) else None
    if kind is None:
        return {"struct": [{"name": name, **yaml_type(one)} for name, one in feature.items()]}
    if kind == "Image":
        return {"dtype": "image"}
    if kind == "Sequence":
        inner = yaml_type(feature["feature"])
        return {"list": inner["dtype"] if list(inner) == ["dtype"] else inner}
    if kind == "ClassLabel":
        return {"dtype": {"class_label": {"names": {str(i): name for i, name in enumerate(feature["names"])}}}}
    return {"dtype": feature["dtype"]}


def _of_channel(channel: Channel, categories: Sequence[str]) -> Column:
    name = channel.name
    if channel.kind == "picture":
        return Column(
            channel.column,
            {"_type": "Image"},
            lambda sample: {"bytes": sample.contents[name], "path": f"{sample.name}.{channel.extension}"},
        )
    if channel.kind == "objects":
        return Column(channel.column, _objects_feature(categories), lambda sample: _objects(sample.contents[name]))
    return Column(channel.column, value("binary"), lambda sample: sample.contents[name])


def _objects_feature(categories: Sequence[str]) -> dict[str, Any]:
    return {
        "bbox": sequence(sequence(value("float32"))),
        "category": sequence({"names": list(categories), "_type": "ClassLabel"}),
        **{name: sequence(value(dtype)) for name, (dtype, _) in _OBJECT_FIELDS.items()},
        "amodal_rle": sequence(value("string")),
    }


def _objects(content: bytes) -> dict[str, list[Any]]:
    """The plants in view, field by field."""
    plants = load_json(content)["annotations"]
    return {
        "bbox": [one["bbox"] for one in plants],
        "category": [one["category_id"] - 1 for one in plants],
        **{name: [one.get(key) for one in plants] for name, (_, key) in _OBJECT_FIELDS.items()},
        "amodal_rle": [one.get("amodal_segmentation", {}).get("counts") for one in plants],
    }


def _camera_text(sample: Sample) -> str:
    return json_text(sample.camera)


def _of_index(source: Source) -> list[Column]:
    import pyarrow as pa

    columns = []
    for field in source.index.schema:
        if field.name in _LEFT_OUT:
            continue
        if pa.types.is_map(field.type):
            columns += _of_map(field.name, source.index[field.name])
        elif (feature := _plain(field.type)) is not None:
            name = _RENAMED.get(field.name, field.name)
            columns.append(Column(name, feature, _cell_of(field.name)))
    return columns


def _cell_of(key: str) -> Callable[[Sample], Any]:
    return lambda sample: sample.row[key]


def _plain(kind: Any) -> dict[str, Any] | None:
    """Feature of a column of numbers, texts, or lists of them."""
    import pyarrow as pa

    if pa.types.is_list(kind):
        inner = _plain(kind.value_type)
        return None if inner is None else sequence(inner)
    names = {"double": "float64", "float": "float32"}
    dtype = names.get(str(kind), str(kind))
    known = ("bool", "string", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")
    return value(dtype) if dtype in (*known, "float32", "float64") else None


def _of_map(name: str, column: Any) -> list[Column]:
    """Numbers by name as a field a name, which is 0 where the map leaves it out."""
    keys = sorted({key for chunk in column.chunks for key in chunk.keys.unique().to_pylist()})
    if not keys:
        return []
    feature = {key: value("int64") for key in keys}
    return [Column(name, feature, lambda sample: _filled(sample.row[name], keys))]


def _filled(counts: Mapping[str, int] | None, keys: Sequence[str]) -> dict[str, int | None]:
    return {key: None if counts is None else counts.get(key, 0) for key in keys}
