"""Builds: from the scans of a map to a revision."""

from hashlib import sha256
from typing import Annotated

from fastapi import Header, Response, status
from fastapi.exceptions import RequestValidationError

from app.access.api_router import api_router
from app.access.dependency import CurrentCaller
from app.access.scopes import Scope, needs
from app.builds.parameters import BuildParameters
from app.builds.plans import plan_build
from app.drives.stored_images import require_images
from app.http.answer_headers import LOCATION, headed
from app.http.bodies.bodies import Json
from app.http.errors import JSON_BODY, REVISION, WRITING
from app.http.problems import problems
from app.http.slugs import MapSlug
from app.jobs.schemas import JobOut
from app.service import Running
from core.errors import EmptyDrive, InvalidParameters, UnknownDrive
from storage import errors as stored
from storage.catalog import IdempotencyKey

router = api_router(tags=["builds"], dependencies=(needs(Scope.MAPS_WRITE),))

IdempotencyKeyHeader = Annotated[
    str | None,
    Header(
        min_length=1,
        max_length=255,
        pattern="^[!-~]+$",
        description="A name that the client gives to this request, as a UUID, to repeat it safely.",
    ),
]


@router.post(
    "/maps/{map}/builds",
    status_code=status.HTTP_202_ACCEPTED,
    responses={
        202: headed(LOCATION),
        **problems(
            stored.MapNotFound,
            stored.DriveNotFound,
            stored.BasisNotFound,
            UnknownDrive,
            *REVISION,
            EmptyDrive,
            InvalidParameters,
            stored.RequestKeyReused,
            stored.ReturnsGone,
            stored.TooManyBuilds,
            *JSON_BODY,
            *WRITING,
        ),
    },
)
def build(
    map_slug: MapSlug,
    parameters: Json[BuildParameters],
    running: Running,
    caller: CurrentCaller,
    response: Response,
    idempotency_key: IdempotencyKeyHeader = None,
) -> JobOut:
    """Queue a build; follow it at `Location`.

    A request is rejected for unknown drives, an unknown base, a map without scans, parameters that
    do not fit the sensor, images of returns that were dropped, and `force` or `max_recall_loss`
    without `make_live`.

    With `base`, the new revision is that one with the drives of `add` after its own and without
    those of `remove`. A harmonic map keeps its basis, so that the signatures of vehicles stay
    valid, unless `refit` is set. Nothing that is stored is removed.

    Keys take turns in the queue, and so do the maps of a key; the number of queued builds of a key
    is limited.

    With an `Idempotency-Key`, a client that received no answer can repeat the request: the answer
    is the job that was made, and no other is queued.
    """
    _require_make_live(parameters)
    jobs = running.store.jobs
    key = None if idempotency_key is None else _key_of_request(idempotency_key, parameters)
    job = None if key is None else jobs.made_by(map_slug, key, caller.key_id)
    if job is None:
        record = running.store.maps.get(map_slug)
        plan = plan_build(running.store, record.id, parameters)
        require_images(running.store, record.id, plan.drives, plan.parameters.map_parameters())
        job = jobs.create(
            map_slug,
            (parameters if parameters.base is None else plan.parameters).as_json(),
            plan=plan.model_dump(mode="json"),
            idempotency_key=key,
            key_id=caller.key_id,
            most_queued=running.settings.max_queued_builds_per_key,
        )
        running.runner.wake()
    response.headers[LOCATION] = f"/v1/jobs/{job.id}"
    return JobOut.from_record(job)


def _require_make_live(parameters: BuildParameters) -> None:
    """Reject options of `make_live` without it.

    Not in the model, which also reads the jobs of older versions: these accepted them.
    """
    for name in ("force", "max_recall_loss"):
        default = BuildParameters.model_fields[name].default
        if not parameters.make_live and getattr(parameters, name) != default:
            message = (
                f"{name} only applies with make_live: true; without it a build is not"
                " compared with the live revision, and only the first one of a map becomes live"
            )
            raise RequestValidationError(
                [{"type": "value_error", "loc": ("body", name), "msg": message}]
            )


def _key_of_request(name: str, parameters: BuildParameters) -> IdempotencyKey:
    content = parameters.model_dump_json(exclude_unset=True)
    return IdempotencyKey(name, sha256(content.encode()).hexdigest())
