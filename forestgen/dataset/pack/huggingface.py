"""A folder that Hugging Face's `datasets` opens: Parquet files with the pictures inside, and a README that lists them.

Rows are written in groups of bounded size, so that a reader streams and memory stays flat. The library keeps its types
as JSON in a Parquet file's metadata, so that a column of pictures opens as pictures.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BufferedWriter
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from forestgen.core.errors import DatasetError
from forestgen.dataset.formats.format import json_text
from forestgen.dataset.pack.pack import Contents, Pack, Shard
from forestgen.dataset.pack.source import Channel, Sample, Source
from forestgen.dataset.safe_path import load_json, one_line
from forestgen.recipe.sources import yaml_text

_FOLDER = "data"
_GROUP_BYTES, _GROUP_ROWS = 32 << 20, 100
_CELL_BYTES = 256  # a leaf's share of the footer and of page headers, a group
_VALUE_BYTES = 32  # what a value takes beside its own bytes: length and levels
# Of the index, what each frame's columns say in another way.
_LEFT_OUT = ("frame", "folder", "split")
_RENAMED = {"image": "image_number"}  # `image` is the picture

# Field of `objects`, as of an annotation -> type: lists with a value a plant in view.
_OBJECT_FIELDS = {
    "plant_id": "int64", "area": "int64", "truncated": "bool", "species": "string", "distance_m": "float64",
    "height_m": "float64", "visible_fraction": "float64", "amodal_area": "int64",
}  # fmt: skip


class HuggingFace(Pack):
    """Parquet files that Hugging Face's datasets opens."""

    title = "Hugging Face's datasets"
    frame_bytes = 16384  # what the index and the camera say

    def split_name(self, name: str) -> str:
        """Without hyphens, which the library takes for something else."""
        return name.replace("-", "_")

    def write_split(self, folder: Path, split: str, samples: Iterator[Sample], contents: Contents) -> list[Shard]:
        """Write a split's files: data/SPLIT-00000-of-00003.parquet and so on."""
        columns = _columns_of(contents.source, contents.channels)
        (folder / _FOLDER).mkdir(exist_ok=True)
        schema = _schema(columns)
        # Of pictures no reader wants the smallest and the largest, which else go into the footer.
        measured = [one.name for one in schema if not (pa.types.is_nested(one.type) or pa.types.is_binary(one.type))]
        counts: list[int] = []
        held = next(samples, None)
        while held is not None:
            path = folder / _FOLDER / f"{split}-{len(counts):05d}.part"
            with (
                path.open("wb") as stream,
                pq.ParquetWriter(stream, schema, use_dictionary=False, write_statistics=measured) as writer,
            ):
                file = _File(stream, writer, schema, columns)
                while held is not None:
                    texts_bytes = len(json_text([held.camera, held.row])) + len(columns) * _VALUE_BYTES
                    size_bytes = sum(map(len, held.contents.values())) + texts_bytes
                    if file.frames and file.bytes_with(size_bytes) > contents.shard_bytes:
                        break
                    file.add(held, size_bytes)
                    held = next(samples, None)
                file.flush()
            counts.append(file.frames)
        shards = []
        for number, frames in enumerate(counts):
            name = f"{_FOLDER}/{split}-{number:05d}-of-{len(counts):05d}.parquet"
            path = (folder / _FOLDER / f"{split}-{number:05d}.part").rename(folder / name)
            shards.append(Shard(name, frames, path.stat().st_size))
        return shards

    def opening_code(self, target: str, split: str, shards: Sequence[Shard]) -> tuple[str, str]:
        return "import datasets", f'{split} = datasets.load_dataset("{target}", split="{split}")'

    def front_matter(
        self, contents: Contents, splits: Mapping[str, Sequence[Shard]], of_card: Mapping[str, Any]
    ) -> str:
        """What the library reads: where the splits lie, and the types of the columns."""
        columns = _columns_of(contents.source, contents.channels)
        features = [{"name": column.name, **column.feature.yaml} for column in columns]
        files = [{"split": name, "path": f"{_FOLDER}/{name}-*.parquet"} for name in splits]
        sizes = {name: sum(one.size_bytes for one in shards) for name, shards in splits.items()}
        content = {
            **of_card,
            "configs": [{"config_name": "default", "data_files": files}],
            "dataset_info": {
                "features": features,
                "splits": [
                    {"name": name, "num_bytes": sizes[name], "num_examples": sum(one.frames for one in shards)}
                    for name, shards in splits.items()
                ],
                "download_size": sum(sizes.values()),
                "dataset_size": sum(sizes.values()),
            },
        }
        return f"---\n{yaml_text(content)}---\n\n"


PACK = HuggingFace()


def _schema(columns: Sequence[Column]) -> Any:
    features = {column.name: column.feature.json for column in columns}
    text = json.dumps({"info": {"features": features}})
    fields = [(column.name, column.feature.arrow) for column in columns]
    return pa.schema(fields, metadata={"huggingface": text})


class _File:
    """One Parquet file that is being written; rows wait until a group is full."""

    def __init__(self, stream: BufferedWriter, writer: Any, schema: Any, columns: Sequence[Column]) -> None:
        self._stream, self._writer, self._schema, self._columns = stream, writer, schema, columns
        self._group: list[list[Any]] = []  # rows
        self._group_bytes = self._groups = self.frames = 0
        self._footer_bytes = 3 * len(schema.serialize()) + 4096
        self._leaves = _leaves(schema)

    def bytes_with(self, sample_bytes: int) -> int:
        """Size of the file, from above, if a sample of so many bytes were added."""
        headers = (self._groups + 1) * self._leaves * _CELL_BYTES
        return int(self._stream.tell()) + self._group_bytes + sample_bytes + self._footer_bytes + headers

    def add(self, sample: Sample, sample_bytes: int) -> None:
        self._group.append([_cell(column, sample) for column in self._columns])
        self._group_bytes += sample_bytes
        self.frames += 1
        if self._group_bytes >= _GROUP_BYTES or len(self._group) >= _GROUP_ROWS:
            self.flush()

    def flush(self) -> None:
        """Write the rows that wait."""
        if not self._group:
            return
        cells = zip(*self._group, strict=True)
        arrays = [_array(column, values) for column, values in zip(self._columns, cells, strict=True)]
        self._writer.write_table(pa.Table.from_arrays(arrays, schema=self._schema))
        self._group, self._group_bytes = [], 0
        self._groups += 1


def _cell(column: Column, sample: Sample) -> Any:
    """A frame's value of a column; what the data set's files do not hold in their format raises `DatasetError`."""
    try:
        return column.cell(sample)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        got = f"{type(error).__name__}: {error}"[:200]
        raise DatasetError(f"no {column.name} can be made of a frame", where=sample.name, got=got) from error


def _array(column: Column, values: Sequence[Any]) -> Any:
    """Values of a group's rows in the column's type."""
    try:
        return pa.array(values, column.feature.arrow)
    except (TypeError, ValueError, OverflowError, pa.ArrowException) as error:
        where, got = f"column {column.name}", one_line(error)
        raise DatasetError("frames have values of a wrong type", where=where, got=got) from error


def _leaves(schema: Any) -> int:
    """How many columns the file has when lists and structs are taken apart."""

    def count(kind: Any) -> int:
        return sum(count(kind.field(i).type) for i in range(kind.num_fields)) if kind.num_fields else 1

    return sum(count(one.type) for one in schema)


@dataclass(frozen=True)
class Feature:
    """A type, as the library has it in JSON, in Arrow, and in the `dataset_info` of a README."""

    json: Any
    arrow: Any
    yaml: dict[str, Any]


@dataclass(frozen=True)
class Column:
    """A column of the data set."""

    name: str
    feature: Feature
    cell: Callable[[Sample], Any]  # plain value of a frame


def _columns_of(source: Source, channels: Sequence[Channel]) -> list[Column]:
    """All columns of a pack: the channels', the camera, what the index says."""
    categories = list(source.classes["categories"].values())
    columns = [Column("frame", _value("string"), lambda sample: sample.name)]
    columns += [_of_channel(channel, categories) for channel in channels]
    columns.append(Column("camera_parameters", _value("string"), lambda sample: json_text(sample.camera)))
    if any(channel.name == "depth" for channel in channels):
        columns.append(Column("depth_unit_m", _value("float64"), lambda sample: sample.depth_unit_m))
    return columns + _of_index(source)


def _value(dtype: str) -> Feature:
    return Feature({"dtype": dtype, "_type": "Value"}, pa.type_for_alias(dtype), {"dtype": dtype})


def _sequence(item: Feature) -> Feature:
    """A list; by the older of its two names, which every version of the library knows."""
    inner = item.yaml["dtype"] if list(item.yaml) == ["dtype"] else item.yaml
    return Feature({"feature": item.json, "_type": "Sequence"}, pa.list_(item.arrow), {"list": inner})


def _struct(fields: Mapping[str, Feature]) -> Feature:
    kind = pa.struct([(name, one.arrow) for name, one in fields.items()])
    yaml = {"struct": [{"name": name, **one.yaml} for name, one in fields.items()]}
    return Feature({name: one.json for name, one in fields.items()}, kind, yaml)


def _of_channel(channel: Channel, categories: Sequence[str]) -> Column:
    name = channel.name
    if channel.kind == "picture":
        stored = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
        return Column(
            channel.column,
            Feature({"_type": "Image"}, stored, {"dtype": "image"}),
            lambda sample: {"bytes": sample.contents[name], "path": f"{sample.name}.{channel.extension}"},
        )
    if channel.kind == "objects":
        return Column(channel.column, _objects_feature(categories), lambda sample: _objects(sample.contents[name]))
    return Column(channel.column, _value("binary"), lambda sample: sample.contents[name])


def _objects_feature(categories: Sequence[str]) -> Feature:
    numbered = {"dtype": {"class_label": {"names": {str(i): name for i, name in enumerate(categories)}}}}
    category = Feature({"names": list(categories), "_type": "ClassLabel"}, pa.int64(), numbered)
    return _struct(
        {
            "bbox": _sequence(_sequence(_value("float32"))),
            "category": _sequence(category),
            **{name: _sequence(_value(dtype)) for name, dtype in _OBJECT_FIELDS.items()},
            "amodal_rle": _sequence(_value("string")),
        }
    )


def _objects(content: bytes) -> dict[str, list[Any]]:
    """The plants in view, field by field."""
    plants = load_json(content)["annotations"]
    return {
        "bbox": [one["bbox"] for one in plants],
        "category": [one["category_id"] - 1 for one in plants],
        **{name: [one.get(name) for one in plants] for name in _OBJECT_FIELDS},
        "amodal_rle": [one.get("amodal_segmentation", {}).get("counts") for one in plants],
    }


def _of_index(source: Source) -> list[Column]:
    columns = []
    for field in source.index.schema:
        if field.name in _LEFT_OUT:
            continue
        if pa.types.is_map(field.type):
            columns += _of_map(field.name, source.index[field.name])
        elif (feature := _plain(field.type)) is not None:
            name = _RENAMED.get(field.name, field.name)
            columns.append(Column(name, feature, lambda sample, key=field.name: sample.row[key]))  # type: ignore[misc]
    return columns


def _plain(kind: Any) -> Feature | None:
    """Feature of a column of numbers, texts, or lists of them."""
    if pa.types.is_list(kind):
        inner = _plain(kind.value_type)
        return None if inner is None else _sequence(inner)
    names = {"double": "float64", "float": "float32"}
    dtype = names.get(str(kind), str(kind))
    known = ("bool", "string", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")
    return _value(dtype) if dtype in (*known, "float32", "float64") else None


def _of_map(name: str, column: Any) -> list[Column]:
    """Numbers by name as a field a name, which is 0 where the map leaves it out."""
    keys = sorted({key for chunk in column.chunks for key in chunk.keys.unique().to_pylist()})
    if not keys:
        return []

    def cell(sample: Sample) -> dict[str, int | None]:
        counts = sample.row[name]
        return {key: None if counts is None else counts.get(key, 0) for key in keys}

    return [Column(name, _struct({key: _value("int64") for key in keys}), cell)]
