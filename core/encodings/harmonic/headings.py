"""Waves over headings, as products with matrices: a third of the time of transforms."""

from functools import lru_cache

import numpy as np

from core.arrays import Complex64Array, ComplexArray, Float32Array, FloatArray, frozen

_LEAST_SAMPLES = 128
_SAMPLES_A_WAVE = 8


def samples_for(harmonics: int) -> int:
    """Return in how many headings to compare so many harmonics.

    A parabola finds the peak between them: of the shortest wave it needs eight.
    """
    return max(_LEAST_SAMPLES, _SAMPLES_A_WAVE * harmonics)


def over_headings(waves: Complex64Array, samples: int) -> Float32Array:
    """Return Re sum_m c_m w_m e^(i m t) of `(n, d, m)` waves in each heading; c_0 = 1, else 2."""
    parts = np.ascontiguousarray(waves).view(np.float32)
    flat = parts.reshape(-1, parts.shape[-1]) @ _headings_of_parts(samples, waves.shape[-1])
    return np.asarray(flat.reshape(*waves.shape[:-1], -1))


@lru_cache(maxsize=16)
def _headings_of_parts(samples: int, count: int) -> Float32Array:
    """Return the matrix from real and imaginary parts in turn to headings, `(2 m, samples)`."""
    turns = (turns_of(samples, count) * _counted(count)).T
    parts = np.stack([turns.real, -turns.imag], axis=1)
    return frozen(parts.reshape(2 * count, -1), np.float32)


def in_headings(waves: ComplexArray | FloatArray, samples: int) -> Float32Array:
    """Return the matrix from `as_real` of x to sum_d w_d conj(x_d) e^(i d t) in each heading t.

    Args:
        waves: `(m,)` w_d, from d = 0 on; those below 0 are their conjugates.
        samples: Evenly spaced headings, from 0 on.
    """
    count = len(waves)
    turned = turns_of(samples, count) * (waves * _counted(count)).astype(np.complex64)
    matrix = np.empty((samples, 2 * count - 1), np.float32)
    matrix[:, :count], matrix[:, count:] = turned.real, turned.imag[:, 1:]
    return matrix


@lru_cache(maxsize=16)
def turns_of(samples: int, count: int) -> Complex64Array:
    """Return e^(i d t) in each heading t, `(samples, d)`."""
    turns = np.exp(2j * np.pi / samples * np.outer(np.arange(samples), np.arange(count)))
    return frozen(turns, np.complex64)


@lru_cache(maxsize=16)
def _counted(count: int) -> Float32Array:
    """Return how often each wave counts: those below 0 are the conjugates of those above."""
    return frozen(np.where(np.arange(count) > 0, 2.0, 1.0), np.float32)
