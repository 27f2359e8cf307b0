"""A folder that Hugging Face's `datasets` opens: Parquet files with the pictures inside, and a README that lists them.

Rows are written in groups of bounded size, so that a reader streams and memory stays flat.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from forestgen.core.errors import DatasetError
from forestgen.dataset.formats.shards import json_text
from forestgen.dataset.pack.columns import Column, arrow_type, columns_of, yaml_type
from forestgen.dataset.pack.pack import Contents, Pack
from forestgen.dataset.pack.samples import Sample, Shard

_FOLDER = "data"
_GROUP_BYTES, _GROUP_ROWS = 32 << 20, 100
_CELL_BYTES = 256  # a leaf's share of the footer and of page headers, a group
_VALUE_BYTES = 32  # what a value takes beside its own bytes: length and levels


class HuggingFace(Pack):
    """Parquet files that Hugging Face's datasets opens."""

    title = "Hugging Face's datasets"
    frame_bytes = 16384  # what the index and the camera say

    def split_name(self, name: str) -> str:
        """Without hyphens, which the library takes for something else."""
        return name.replace("-", "_")

    def write_split(self, folder: Path, split: str, samples: Iterator[Sample], contents: Contents) -> list[Shard]:
        """Write a split's files: data/SPLIT-00000-of-00003.parquet and so on."""
        columns = columns_of(contents.source, contents.channels)
        (folder / _FOLDER).mkdir(exist_ok=True)
        schema = _schema(columns)
        counts: list[int] = []
        held = next(samples, None)
        while held is not None:
            with _File(folder / _FOLDER / _part_name(split, len(counts)), schema, columns) as file:
                while held is not None:
                    size_bytes = _row_bytes(held, columns)
                    if file.frames and file.bytes_with(size_bytes) > contents.shard_bytes:
                        break
                    file.add(held, size_bytes)
                    held = next(samples, None)
            counts.append(file.frames)
        return [_named(folder, split, number, counts) for number in range(len(counts))]

    def opening_code(self, target: str, split: str, shards: Sequence[Shard]) -> tuple[str, str]:
        return "import datasets", f'{split} = datasets.load_dataset("{target}", split="{split}")'

    def front_matter(
        self, contents: Contents, splits: Mapping[str, Sequence[Shard]], of_card: Mapping[str, Any]
    ) -> str:
        """What the library reads: where the splits lie, and the types of the columns."""
        columns = columns_of(contents.source, contents.channels)
        features = [{"name": column.name, **yaml_type(column.feature)} for column in columns]
        sizes = {name: sum(one.size_bytes for one in shards) for name, shards in splits.items()}
        content = {
            **of_card,
            "configs": [
                {
                    "config_name": "default",
                    "data_files": [{"split": name, "path": f"{_FOLDER}/{name}-*.parquet"} for name in splits],
                }
            ],
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
        return f"---\n{_yaml(content)}---\n\n"


PACK = HuggingFace()


def _yaml(content: Any) -> str:
    from ruamel.yaml import YAML

    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 4096
    stream = io.StringIO()
    yaml.dump(content, stream)
    return stream.getvalue()


def _part_name(split: str, number: int) -> str:
    return f"{split}-{number:05d}.part"


def _named(folder: Path, split: str, number: int, counts: Sequence[int]) -> Shard:
    """Give a file its name, which says how many there are."""
    name = f"{_FOLDER}/{split}-{number:05d}-of-{len(counts):05d}.parquet"
    path = (folder / _FOLDER / _part_name(split, number)).rename(folder / name)
    return Shard(name, counts[number], path.stat().st_size)


def _schema(columns: Sequence[Column]) -> Any:
    import pyarrow as pa

    features = {column.name: column.feature for column in columns}
    text = json.dumps({"info": {"features": features}})
    fields = [(column.name, arrow_type(column.feature)) for column in columns]
    return pa.schema(fields, metadata={"huggingface": text})


def _row_bytes(sample: Sample, columns: Sequence[Column]) -> int:
    contents = sum(len(content) for content in sample.contents.values())
    return contents + len(json_text([sample.camera, sample.row])) + len(columns) * _VALUE_BYTES


class _File:
    """One Parquet file that is being written; rows wait until a group is full."""

    def __init__(self, path: Path, schema: Any, columns: Sequence[Column]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        self._columns, self._schema = columns, schema
        self._stream = path.open("wb")
        # Of pictures no reader wants the smallest and the largest, which else go into the footer.
        measured = [one.name for one in schema if not (pa.types.is_nested(one.type) or pa.types.is_binary(one.type))]
        self._writer = pq.ParquetWriter(self._stream, schema, use_dictionary=False, write_statistics=measured)
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
            self._flush()

    def _flush(self) -> None:
        import pyarrow as pa

        cells = zip(*self._group, strict=True)
        arrays = [_array(column, values) for column, values in zip(self._columns, cells, strict=True)]
        self._writer.write_table(pa.Table.from_arrays(arrays, schema=self._schema))
        self._group, self._group_bytes = [], 0
        self._groups += 1

    def __enter__(self) -> _File:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        try:
            if kind is None and self._group:
                self._flush()
        finally:
            try:
                self._writer.close()
            finally:
                self._stream.close()


def _cell(column: Column, sample: Sample) -> Any:
    """A frame's value of a column; what the data set's files do not tell in their format raises `DatasetError`."""
    try:
        return column.cell(sample)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        got = f"{type(error).__name__}: {error}"[:200]
        raise DatasetError(f"no {column.name} can be made of a frame", where=sample.name, got=got) from error


def _array(column: Column, values: Sequence[Any]) -> Any:
    """Values of a group's rows in the column's type."""
    import pyarrow as pa

    try:
        return pa.array(values, arrow_type(column.feature))
    except (TypeError, ValueError, OverflowError, pa.ArrowException) as error:
        got = " ".join(str(error).split())[:200]
        raise DatasetError("frames have values of a wrong type", where=f"column {column.name}", got=got) from error


def _leaves(schema: Any) -> int:
    """How many columns the file has when lists and structs are taken apart."""

    def count(kind: Any) -> int:
        return sum(count(kind.field(i).type) for i in range(kind.num_fields)) if kind.num_fields else 1

    return sum(count(one.type) for one in schema)
