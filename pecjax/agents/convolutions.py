"""Convolutions: images of a row of features, shrunk 16 times each way."""

from __future__ import annotations

from collections.abc import Callable

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

CONVOLUTIONS = ((16, 4), (32, 2), (32, 2))  # channels, and the kernel's size, which is its stride too


class Convolutions(nn.Module):
    """Three convolutions over each image, and what is no image as it is.

    Their kernels do not overlap (4×4, 2×2, 2×2), so that each is a matrix product over patches,
    which XLA is quick at on every device; its convolutions' gradients are slow on the CPU.

    Attributes:
        image_shapes: (H, W) or (H, W, C) of the images that the features begin with.
        product: of its layers, in place of `jax.lax.dot_general`.
    """

    image_shapes: tuple[tuple[int, ...], ...]
    product: Callable[..., jax.Array] | None = None

    @nn.compact
    def __call__(self, features: jax.Array) -> jax.Array:
        """Features (…, F) -> (…, F')."""
        parts = []
        for shape in self.image_shapes:
            pixels = int(np.prod(shape))
            x, features = features[..., :pixels], features[..., pixels:]
            x = x.reshape(*x.shape[:-1], *shape[:2], *(shape[2:] or (1,)))
            for channels, kernel in CONVOLUTIONS:
                x = nn.relu(nn.Dense(channels, dot_general=self.product)(patches(x, kernel)))
            parts.append(x.reshape(*x.shape[:-3], -1))
        return jnp.concatenate([*parts, features], axis=-1)


def patches(image: jax.Array, size: int) -> jax.Array:
    """Cuts (…, H, W, C) into squares, (…, ⌈H/size⌉, ⌈W/size⌉, size²·C), zeros beyond the edge."""
    *batch, height, width, channels = image.shape
    rows, columns = -(-height // size), -(-width // size)
    edge = [(0, 0)] * len(batch) + [(0, rows * size - height), (0, columns * size - width), (0, 0)]
    cut = jnp.pad(image, edge).reshape(*batch, rows, size, columns, size, channels)
    return jnp.moveaxis(cut, -4, -3).reshape(*batch, rows, columns, size * size * channels)
