"""Masks as COCO's compressed run-length code: ``{"size": [H, W], "counts": str}``, runs down the columns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from forestgen.labels.amodal import AmodalMasks


def encode_masks(instance: NDArray[np.uint32]) -> dict[int, dict[str, Any]]:
    """Run-length code of every plant of a mask, in one pass over the pixels.

    Parameters
    ----------
    instance : (H, W) uint32; 0 is no plant.

    Returns
    -------
    plant_id -> code, ids rising.
    """
    height, width = instance.shape
    flat = instance.T.ravel()
    first = np.concatenate([[0], np.flatnonzero(flat[1:] != flat[:-1]) + 1])
    owner = flat[first]
    end = np.concatenate([first[1:], [flat.size]])
    order = np.argsort(owner, kind="stable")
    ids, begin = np.unique(owner[order], return_index=True)
    groups = np.split(order, begin[1:])
    return {
        int(plant): _compress(first[runs], end[runs], height, width)
        for plant, runs in zip(ids, groups, strict=True)
        if plant != 0
    }


def encode_amodal(amodal: AmodalMasks, row: int, size_px: tuple[int, int]) -> dict[str, Any]:
    """Run-length code, over the whole image of width and height `size_px`, of a row's amodal mask."""
    width, height = size_px
    left, top, _, _ = amodal.box_px[row].tolist()
    column, line = np.nonzero(amodal.mask_of(row).T)
    pixel = (column + left) * height + line + top
    if len(pixel) == 0:
        return _compress(pixel, pixel, height, width)
    breaks = np.flatnonzero(np.diff(pixel) != 1)
    first = pixel[np.concatenate([[0], breaks + 1])]
    end = pixel[np.concatenate([breaks, [len(pixel) - 1]])] + 1
    return _compress(first, end, height, width)


def _compress(first: NDArray[np.intp], end: NDArray[np.intp], height: int, width: int) -> dict[str, Any]:
    """RLE of runs [first, end) of ones: alternating lengths of zeros and ones, zeros first."""
    from pycocotools import mask

    edges = np.stack([first, end], axis=1).ravel()
    counts = np.diff(edges, prepend=0)
    if len(edges) == 0 or edges[-1] != height * width:
        counts = np.append(counts, height * width - (edges[-1] if len(edges) else 0))
    rle = mask.frPyObjects({"size": [height, width], "counts": counts.tolist()}, height, width)
    return {"size": [height, width], "counts": rle["counts"].decode("ascii")}
