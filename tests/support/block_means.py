"""A third encoding, which no product code knows: means of r1 x r2 blocks of a range image.

It has no basis to fit, so that all its maps share one.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from app.jobs.worker import run_job
from core.arrays import Float32Array, FloatArray, IntArray
from core.encodings.base import Encoding
from core.encodings.basis import Basis, signature_parameters
from core.encodings.blocks import read_blocks
from core.encodings.model import Model
from core.encodings.registry import register
from core.encodings.search import DistanceSearch
from core.encodings.signature import Packing, Signature
from core.errors import InvalidSignature
from core.projection.imager import ImageKind
from core.projection.reducer import Reducer
from core.projection.visibility import FULL_VIEW
from core.revision import content_digest

NAME = "block-means"


def block_means(images: Float32Array, ranks: tuple[int, int]) -> FloatArray:
    """Return the means of `(..., I, J)` images' blocks, `(..., r1, r2)`."""
    sums = images.astype(np.float64)
    for axis, rank in ((-2, ranks[0]), (-1, ranks[1])):
        starts, sizes = _blocks(images.shape[axis], rank)
        sums = np.add.reduceat(sums, starts, axis=axis)
        sums /= sizes[:, None] if axis == -2 else sizes
    return sums


def _blocks(size: int, count: int) -> tuple[IntArray, IntArray]:
    edges = np.linspace(0, size, count + 1).astype(np.int64)
    return edges[:-1], np.diff(edges)


@dataclass(frozen=True, eq=False)
class BlockMeansBasis(Basis):
    """Nothing but how images are made."""

    def encode(self, image, ranks=None):
        self.require_ranks(ranks or self.kept_ranks)
        return (Signature(self.project(image), None, self.digest, NAME),)

    def project(self, image):
        self.require_grid(image)
        return block_means(image.cells, self.parameters.ranks).astype(np.float32)

    def arrays(self):
        return {}

    def as_values(self):
        return {}


@dataclass(frozen=True, eq=False)
class BlockMeansModel(Model):
    """All scans' block means."""

    encoding: ClassVar[str] = NAME

    signatures: Any
    segment_start: IntArray
    shape: tuple[int, int]

    def __post_init__(self):
        self._require_rising(len(self.signatures))

    @property
    def ranks(self):
        return self.signatures.shape[1:]

    @property
    def grid_shape(self):
        return self.shape

    def arrays(self):
        return {"signatures": self.signatures, "segment_start": self.segment_start}

    def search(self, signatures):
        if len(signatures) != 1 or signatures[0].encoding != NAME:
            raise InvalidSignature(f"wanted one signature of the {NAME} encoding")
        return self.search_values(signatures[0].values)

    def search_values(self, values, view=FULL_VIEW):
        apart = np.linalg.norm(self.signatures - values.astype(float), axis=(1, 2))
        rows = np.arange(len(self))
        return DistanceSearch(tuple(range(self.segments)), rows, apart, len(self))

    def own_queries(self, rows, named, segments=None):
        for row in rows:
            yield (Signature(self.signatures[row], None, named, NAME),)

    def basis_digests(self, parameters):
        return (content_digest({}, signature_parameters(parameters)),)

    def basis(self, revision, digest, parameters, segments):
        return BlockMeansBasis(revision, digest, parameters)

    def select(self, rows, segments, segment_start):
        return BlockMeansModel(self.signatures[rows], segment_start, self.shape)

    def joined(self, others, segment_start):
        signatures = np.concatenate([model.signatures for model in (self, *others)])
        return BlockMeansModel(signatures, segment_start, self.shape)


class BlockMeans(Encoding):
    """The encoding."""

    name = NAME
    reducers: ClassVar = {ImageKind.RANGE: Reducer.NEAREST}
    dtypes: ClassVar = {"signatures": "<f4"}
    layouts: ClassVar = {200: "block means"}

    def elements(self, parameters, segments, scans):
        r1, r2 = parameters.ranks
        return scans * r1 * r2

    def fit(self, images, trajectory, segment_start, parameters, progress, kept=None, grams=None):
        progress.start("averaging", len(images))
        signatures = np.empty((len(images), *parameters.ranks), np.float32)
        left, whole = np.zeros(len(images)), np.zeros(len(images))
        (rows, columns), (r1, r2) = parameters.grid.shape, parameters.ranks
        sizes = np.outer(_blocks(rows, r1)[1], _blocks(columns, r2)[1])
        for first, block in read_blocks(images, 0, len(images), parameters.imager.shape, progress):
            at = slice(first, first + len(block))
            signatures[at] = block_means(block, parameters.ranks)
            whole[at] = np.square(block, dtype=np.float64).sum(axis=(1, 2))
            left[at] = whole[at] - (sizes * signatures[at].astype(float) ** 2).sum(axis=(1, 2))
        left, whole = (np.add.reduceat(sums, segment_start[:-1]) for sums in (left, whole))
        errors = np.sqrt(np.clip(left / np.maximum(whole, 1.0), 0.0, 1.0))
        return BlockMeansModel(signatures, segment_start, parameters.grid.shape), errors

    def read_model(self, parameters, arrays):
        return BlockMeansModel(arrays["signatures"], arrays["segment_start"], parameters.grid.shape)

    def read_basis(self, revision, digest, parameters, values):
        return BlockMeansBasis(revision, digest, parameters)

    def pack(self, signatures, packing):
        if packing != Packing.FLOAT16 or len(signatures) != 1:
            raise InvalidSignature("one signature is packed, as float16")
        return 200, signatures[0].values.astype("<f2").tobytes()

    def unpack(self, layout, body, shape, revision):
        if len(body) != 2 * shape[0] * shape[1]:
            raise InvalidSignature(f"wanted {2 * shape[0] * shape[1]} bytes, got {len(body)}")
        values = np.frombuffer(body, "<f2").astype(np.float32).reshape(shape)
        return (Signature(values, None, revision, NAME),)

    def as_values(self, signature):
        return {"encoding": NAME, "means": signature.values.tolist()}

    def from_values(self, values, revision):
        try:
            means = np.array(values["means"], dtype=np.float32)
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidSignature(f"means cannot be read: {error!r}") from error
        return Signature(means, None, revision, NAME)


BLOCK_MEANS = BlockMeans()


def run_job_with_block_means(*arguments: Any) -> None:
    """Be the process of a build in a service whose operator registered the encoding."""
    register(BLOCK_MEANS)
    run_job(*arguments)
