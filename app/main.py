"""The application: `create_app(settings)`; nothing is built at import."""

import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache
from importlib.metadata import version

from fastapi import APIRouter, FastAPI
from fastapi_offline import FastAPIOffline
from starlette.concurrency import run_in_threadpool
from starlette.routing import BaseRoute

from app.access.access import Access, make_first_key
from app.access.admission import Admission
from app.access.trail import AuditTrail
from app.builds.job_events import JobEvents
from app.builds.runner import JobRunner
from app.http.bodies.spool import SpoolRoom
from app.http.bodies.unread import UnreadBody
from app.http.metrics import Metrics
from app.http.observing import RequestObserver
from app.http.openapi import complete_openapi
from app.http.origins import allow_origins
from app.http.pools import Pools
from app.http.problems import add_handlers
from app.http.streams import Streams
from app.maps.collector import GarbageCollector
from app.process import one_blas_thread
from app.revisions.loaded import LoadedRevisions
from app.routes import api, open_routes, streams
from app.scrub import Scrub
from app.service import Service
from app.settings import Settings
from app.systemd import supervised
from app.tracking.tracks import Tracks
from storage.catalog import JobRecord
from storage.store import Store

_log = logging.getLogger("tensormap")

_DESCRIPTION = """Stores LiDAR topological maps and answers *where am I?* from one scan, or from a
signature of some 60 bytes. Post scans to a drive, build, localize."""


def create_app(settings: Settings | None = None) -> FastAPI:
    """Make the application.

    Its store is opened when it starts and closed when it ends.

    Args:
        settings: What the operator chose; read from the environment if not given.
    """
    chosen = settings or Settings()
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        one_blas_thread()
        pools = Pools(chosen)
        pools.size_the_default()
        service = await run_in_threadpool(_start, chosen, metrics, pools)
        app.state.service = service
        try:
            async with supervised():
                yield
        finally:
            await run_in_threadpool(_stop, service)

    app = FastAPIOffline(
        title="TensorMap",
        version=version("tensormap-server"),
        description=_DESCRIPTION,
        lifespan=lifespan,
        separate_input_output_schemas=False,
    )
    app.state.settings = chosen
    add_handlers(app)
    app.add_middleware(Admission)
    app.add_middleware(AuditTrail)
    app.add_middleware(UnreadBody)
    allow_origins(app, chosen.allowed_origins)
    app.add_middleware(RequestObserver, metrics=metrics)  # the last one added is the outermost
    app.router.routes.extend(_routes())
    complete_openapi(app)
    return app


@cache
def _routes() -> tuple[BaseRoute, ...]:
    """Return the routes, which are the same in every application and take long to work out."""
    router = APIRouter()
    for part in (api(), streams(), open_routes()):
        router.include_router(part)
    return tuple(router.routes)


def _start(settings: Settings, metrics: Metrics, pools: Pools) -> Service:
    store = Store.serving(settings.data_dir, settings.catalog_url)
    try:
        made = make_first_key(store, settings)
    except BaseException:
        store.close()
        raise
    if made is not None:
        # The one place where a key is shown: only its hash is kept.
        print(f"Administrator key, shown this once: {made}", flush=True)  # noqa: T201
    access = Access(store, settings)
    collector = GarbageCollector(settings, store)

    def ended(job: JobRecord) -> None:
        metrics.built(job)
        collector.wake()

    runner = JobRunner(settings, store, ended=ended)
    runner.start()
    collector.start()
    scrub = Scrub(store, metrics, settings.scrub_days)
    scrub.start()
    return Service(
        settings=settings,
        store=store,
        revisions=LoadedRevisions(store, settings.loaded_revisions),
        runner=runner,
        access=access,
        tracks=Tracks(settings.max_tracks, settings.track_idle_s, settings.max_tracks_per_key),
        streams=Streams(settings.max_streams, settings.max_streams_per_key),
        job_events=JobEvents(store, access),
        metrics=metrics,
        collector=collector,
        scrub=scrub,
        pools=pools,
        spool_room=SpoolRoom(settings, pools.spool),
    )


def _stop(service: Service) -> None:
    service.runner.stop()
    service.collector.stop()
    service.scrub.stop()
    service.store.close()
