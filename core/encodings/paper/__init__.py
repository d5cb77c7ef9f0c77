"""The paper's encoding: each segment has bases of its own (paper, sec. 2.2 and 2.3)."""

from core.encodings.paper.basis import PaperBasis, paper_basis_digests
from core.encodings.paper.encoding import PaperEncoding
from core.encodings.paper.model import PaperModel, SegmentModel

__all__ = [
    "ENCODING",
    "PaperBasis",
    "PaperEncoding",
    "PaperModel",
    "SegmentModel",
    "paper_basis_digests",
]

ENCODING = PaperEncoding()
