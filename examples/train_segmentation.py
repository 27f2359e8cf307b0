# /// script
# requires-python = ">=3.11"
# dependencies = ["jax>=0.6", "flax>=0.10", "optax>=0.2.4", "datasets>=4.0", "pillow>=11", "numpy>=2"]
# ///
"""Train a small U-Net to tell the classes of a generated data set, on a CPU, in minutes.

    forestgen batch examples/train_segmentation.yaml --count 20 --out outputs/young_stand
    forestgen pack outputs/young_stand --format huggingface --out outputs/young_stand_pack
    uv run examples/train_segmentation.py outputs/young_stand_pack

`uv run` makes the script its own environment. Nothing of forestgen is in it: the pack is opened by Hugging Face's
`datasets`, and everything that the training needs is in the pack. JAX and not PyTorch, for PyTorch's wheel for Linux
brings 3 GB of CUDA libraries along; all that is installed here is a quarter of a gigabyte to download.

Prints the loss of each epoch, and for the validation split each class's intersection over union (IoU) beside that of
the constant predictor, which calls every pixel by the commonest class. Writes a picture: image, truth, prediction.
Exit code 0 if the loss fell by a tenth and the mean IoU is better than the constant predictor's, else 1.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import datasets
import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from PIL import Image

BATCH, WIDTHS = 4, (16, 32, 64)  # channels at full, half, ... resolution


class UNet(nn.Module):
    """(N, H, W, 3) pictures in [0, 1] -> (N, H, W, classes) logits; H and W are multiples of 4."""

    classes: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        x, skips = x - 0.5, []
        for width in WIDTHS[:-1]:
            x = self.block(x, width)
            skips.append(x)
            x = nn.max_pool(x, (2, 2), (2, 2))
        x = self.block(x, WIDTHS[-1])
        for width, skip in zip(reversed(WIDTHS[:-1]), reversed(skips), strict=True):
            x = nn.ConvTranspose(width, (2, 2), (2, 2))(x)
            x = self.block(jnp.concatenate([x, skip], axis=-1), width)
        return nn.Conv(self.classes, (1, 1))(x)

    def block(self, x: jax.Array, width: int) -> jax.Array:
        for _ in range(2):
            x = nn.relu(nn.GroupNorm(num_groups=8)(nn.Conv(width, (3, 3))(x)))
        return x


def load(pack: Path) -> tuple[datasets.DatasetDict, list[str]]:
    """The splits of a pack, with pictures as arrays, and the names of its classes."""
    splits = datasets.load_dataset(str(pack)).select_columns(["image", "semantic"]).with_format("numpy")
    names = json.loads((pack / "classes.json").read_text())["semantic"]
    return splits, [names[str(number)] for number in range(len(names))]


def arrays(split: datasets.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """(N, H, W, 3) float32 pictures in [0, 1] and (N, H, W) class numbers, cut to multiples of 4 pixels."""
    rows = split[:]
    images, truth = np.stack(rows["image"]), np.stack(rows["semantic"])
    height, width = (size - size % 4 for size in truth.shape[1:])
    return images[:, :height, :width].astype(np.float32) / 255, truth[:, :height, :width].astype(np.int32)


def class_weights(truth: np.ndarray, classes: int) -> np.ndarray:
    """Rare classes count more, by the root of their rarity; classes that never occur do not count."""
    share = np.bincount(truth.ravel(), minlength=classes) / truth.size
    weights = np.where(share > 0, 1 / np.sqrt(np.maximum(share, 1e-4)), 0)
    return (weights / (weights * share).sum()).astype(np.float32)


def mirrored(rng: np.random.Generator, images: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Half of the pictures left to right: a forest has no handedness."""
    turn = rng.random(len(images)) < 0.5
    return (
        np.where(turn[:, None, None, None], images[:, :, ::-1], images),
        np.where(turn[:, None, None], truth[:, :, ::-1], truth),
    )


def train(
    images: np.ndarray, truth: np.ndarray, classes: int, epochs: int, minutes: float
) -> tuple[Any, UNet, list[float]]:
    """Parameters of the network, the network, and the mean loss of each epoch."""
    model = UNet(classes)
    batch = min(BATCH, len(images))
    parameters = model.init(jax.random.key(0), images[:1])
    steps = epochs * (len(images) // batch)
    optimiser = optax.adamw(optax.cosine_decay_schedule(3e-3, steps))
    state = optimiser.init(parameters)
    weights = jnp.asarray(class_weights(truth, classes))

    def loss_of(parameters: Any, x: jax.Array, y: jax.Array) -> jax.Array:
        each = optax.softmax_cross_entropy_with_integer_labels(model.apply(parameters, x), y)
        return (each * weights[y]).mean()

    @jax.jit
    def step(parameters: Any, state: Any, x: jax.Array, y: jax.Array) -> tuple[Any, Any, jax.Array]:
        loss, gradient = jax.value_and_grad(loss_of)(parameters, x, y)
        change, state = optimiser.update(gradient, state, parameters)
        return optax.apply_updates(parameters, change), state, loss

    rng, losses, start = np.random.default_rng(0), [], time.monotonic()
    for epoch in range(1, epochs + 1):
        order = rng.permutation(len(images))[: len(images) // batch * batch].reshape(-1, batch)
        found = []
        for rows in order:
            parameters, state, loss = step(parameters, state, *mirrored(rng, images[rows], truth[rows]))
            found.append(float(loss))
        losses.append(float(np.mean(found)))
        seconds = time.monotonic() - start
        print(f"epoch {epoch:3d}  loss {losses[-1]:.4f}  {seconds:5.0f} s", flush=True)
        if seconds > 60 * minutes:
            break
    return parameters, model, losses


def predict(parameters: Any, model: UNet, images: np.ndarray) -> np.ndarray:
    """(N, H, W) class numbers."""
    classify = jax.jit(lambda x: model.apply(parameters, x).argmax(axis=-1))
    return np.concatenate([np.asarray(classify(images[i : i + BATCH])) for i in range(0, len(images), BATCH)])


def iou(truth: np.ndarray, predicted: np.ndarray, classes: int) -> np.ndarray:
    """Intersection over union of each class; NaN where a class does not occur in the truth."""
    both = np.bincount(classes * truth.ravel() + predicted.ravel(), minlength=classes**2).reshape(classes, classes)
    hit, of_truth, of_prediction = np.diag(both), both.sum(axis=1), both.sum(axis=0)
    return np.where(of_truth > 0, hit / np.maximum(of_truth + of_prediction - hit, 1), np.nan)


def palette(split: datasets.Dataset, classes: int) -> np.ndarray:
    """(classes, 3) colours: those of the masks' own palette."""
    picture = split.with_format(None).select_columns(["semantic"])[0]["semantic"]
    return np.array(picture.getpalette(), np.uint8).reshape(-1, 3)[:classes]


def sheet(images: np.ndarray, truth: np.ndarray, predicted: np.ndarray, colours: np.ndarray) -> Image.Image:
    """A row a picture: image, truth, prediction; twice as large, so that pixels can be seen."""
    rows = [
        np.concatenate([(image * 255).astype(np.uint8), colours[true], colours[guess]], axis=1)
        for image, true, guess in zip(images, truth, predicted, strict=True)
    ]
    picture = Image.fromarray(np.concatenate(rows))
    return picture.resize((2 * picture.width, 2 * picture.height), Image.Resampling.NEAREST)


def report(names: list[str], learnt: np.ndarray, constant: np.ndarray) -> None:
    """A line a class, and the means."""
    print(f"{'IoU':<14}  learnt  constant")
    for name, ours, theirs in zip(names, learnt, constant, strict=True):
        if not np.isnan(ours):
            print(f"{name:<14}  {ours:6.3f}  {theirs:8.3f}")
    print(f"{'mean':<14}  {np.nanmean(learnt):6.3f}  {np.nanmean(constant):8.3f}")


def main() -> int:
    parser = argparse.ArgumentParser(description="Train a small U-Net on a pack of forestgen, with its own loader.")
    parser.add_argument("pack", type=Path, help="folder of forestgen pack --format huggingface")
    parser.add_argument("--epochs", type=int, default=40)
    parser.add_argument("--minutes", type=float, default=5, help="stop after the epoch that passes this")
    parser.add_argument("--picture", type=Path, default=Path("train_segmentation.png"), help="where to draw results")
    options = parser.parse_args()
    splits, names = load(options.pack)
    if not {"train", "val"} <= set(splits):
        parser.error(f"the pack needs the splits train and val; it has {', '.join(splits)}")
    (x, y), (val_x, val_y) = arrays(splits["train"]), arrays(splits["val"])
    print(f"{len(x)} images for training, {len(val_x)} for validation; classes: {', '.join(names)}")
    parameters, model, losses = train(x, y, len(names), options.epochs, options.minutes)
    score = partial(iou, val_y, classes=len(names))
    predicted = predict(parameters, model, val_x)
    learnt, constant = score(predicted), score(np.full_like(val_y, np.bincount(y.ravel()).argmax()))
    report(names, learnt, constant)
    shown = slice(0, 6)
    sheet(val_x[shown], val_y[shown], predicted[shown], palette(splits["val"], len(names))).save(options.picture)
    print(f"look at {options.picture}")
    learns = losses[-1] < 0.9 * losses[0] and np.nanmean(learnt) > np.nanmean(constant)
    print("the network learns" if learns else "the network does not learn from these images")
    return 0 if learns else 1


if __name__ == "__main__":
    sys.exit(main())
