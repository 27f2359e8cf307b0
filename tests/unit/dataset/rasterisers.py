"""Masks that others make of a polygon whose corners are pixels."""

from __future__ import annotations

import cv2
import numpy as np
from PIL import Image, ImageDraw


def opencv_fill(corners, shape):
    """(H, W) bool, as Ultralytics' polygon2mask makes it of whole pixels."""
    mask = np.zeros(shape, np.uint8)
    cv2.fillPoly(mask, [np.asarray(corners, np.int32)], 1)
    return mask > 0


def pillow_fill(corners, shape):
    """(H, W) bool."""
    image = Image.new("1", shape[::-1])
    ImageDraw.Draw(image).polygon([tuple(map(float, corner)) for corner in corners], fill=1)
    return np.asarray(image)


def overlap(one, other):
    """Intersection over union."""
    return (one & other).sum() / (one | other).sum()
