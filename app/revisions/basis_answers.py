"""Answers to vehicles that ask for a basis: as JSON or npz, and briefly if they have it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any

from fastapi import Header, Response, status

from app.http.accepted import is_preferred
from app.http.answer_headers import ETAG, LEAST_CELLS, headed
from app.http.etags import is_held
from app.revisions.basis_file import NPZ, basis_file
from app.revisions.schemas import BasisOut
from core.encodings.basis import Basis
from core.parameters import MapParameters, Segmentation
from core.revision import content_digest

Accept = Annotated[str, Header(include_in_schema=False)]
IfNoneMatch = Annotated[str | None, Header(description="ETags of the bases that the vehicle has.")]

BASIS_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {NPZ: {"schema": {"type": "string", "format": "binary"}}},
        **headed(sometimes=(ETAG, LEAST_CELLS)),
    },
    304: {"description": "The vehicle has this basis.", **headed(ETAG, sometimes=(LEAST_CELLS,))},
}
"""What these answers are, beside JSON."""


_TAG_DIGITS = 8  # of few parameters that one basis has had


def basis_tag(digest: str, parameters: MapParameters) -> str:
    """Return what names a basis with the parameters that vehicles need, as its ETag.

    The digest of a basis for any views is not of the ranks that a vehicle sends, nor of the height
    that it assumes for its sensor: with the digest alone a vehicle would keep those of before.
    """
    needed = replace(parameters, segmentation=Segmentation.FIXED, verification_images=False)
    return f"{digest}-{content_digest({}, needed.as_attributes())[:_TAG_DIGITS]}"


def basis_answer(
    basis_of: Callable[[], Basis],
    accept: str,
    if_none_match: str | None,
    *,
    tag: str | None,
    least_cells: int | None = None,
) -> Response:
    """Return the answer to a request for a basis.

    Args:
        basis_of: Returns the basis; not called if the vehicle has it.
        accept: The request's `Accept`.
        if_none_match: The request's `If-None-Match`.
        tag: What its ETag says, `basis_tag`; `None` of a part, which has none.
        least_cells: The revision's, `None` of a shared basis, which belongs to no map.
    """
    as_npz = is_preferred(NPZ, accept)
    headers = {"Vary": "Accept"}
    if least_cells is not None:
        headers[LEAST_CELLS] = str(least_cells)
    if tag is not None:
        headers[ETAG] = f'W/"{tag}{"-npz" if as_npz else ""}"'
        if is_held(headers[ETAG], if_none_match):
            return Response(status_code=status.HTTP_304_NOT_MODIFIED, headers=headers)
    basis = basis_of()
    if as_npz:
        return Response(basis_file(basis, least_cells), media_type=NPZ, headers=headers)
    text = BasisOut.from_core(basis, least_cells).model_dump_json()
    return Response(text, media_type="application/json", headers=headers)
