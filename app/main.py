"""The application: `create_app(settings)`; nothing is built at import."""

import asyncio
import itertools
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from http import HTTPStatus

from fastapi import FastAPI
from fastapi.routing import APIRoute
from fastapi_offline import FastAPIOffline
from starlette.concurrency import run_in_threadpool
from starlette.middleware.cors import CORSMiddleware
from starlette.routing import BaseRoute

from app.access import audit_routes, key_routes
from app.access.access import make_first_key
from app.access.admission import Admission
from app.access.trail import AuditTrail
from app.bases import routes as bases
from app.captures import routes as captures
from app.drives import pose_routes, upload_routes
from app.drives import routes as drives
from app.ending import PARTS_S
from app.health import routes as health
from app.http.answer_headers import (
    CONTENT_DISPOSITION,
    CONTENT_RANGE,
    ETAG,
    LEAST_CELLS,
    LIMIT,
    LOCATION,
    POLICY,
    REQUEST_ID,
    RETRY_AFTER,
)
from app.http.bodies.unread import UnreadBody
from app.http.docs_page import serve_docs_page
from app.http.failures import Failures
from app.http.metrics import Metrics
from app.http.observing import NO_ROUTE, RequestObserver
from app.http.openapi import complete_openapi
from app.http.openapi_route import serve_openapi
from app.http.path_prefix import PathPrefix
from app.http.pools import Pools
from app.http.problems import add_handlers
from app.http.redaction import hide
from app.http.route_index import RouteIndex
from app.jobs import build_routes
from app.jobs import routes as jobs
from app.localization import all_maps_routes
from app.localization import routes as localizations
from app.loop_closures import routes as loop_closures
from app.maps import anchor_routes
from app.maps import routes as maps
from app.process import one_blas_thread
from app.recycle_bin import routes as recycle_bin
from app.release import release
from app.revisions import routes as revisions
from app.service import Service
from app.settings import Settings
from app.systemd import supervised
from app.tracking import routes as tracks
from app.tracking import stream_routes
from storage.store import Store

_DESCRIPTION = """Stores LiDAR topological maps and answers *where am I?* from one scan, or from a
signature of 60 to 100 bytes. Post scans to a drive, build, localize."""
_ROUTERS = (
    maps.reading,
    maps.writing,
    anchor_routes.router,
    recycle_bin.reading,
    recycle_bin.writing,
    recycle_bin.purging,
    drives.reading,
    drives.writing,
    drives.scans,
    upload_routes.reading,
    upload_routes.writing,
    pose_routes.reading,
    pose_routes.writing,
    captures.reading,
    captures.writing,
    build_routes.router,
    jobs.reading,
    jobs.writing,
    revisions.router,
    bases.reading,
    bases.writing,
    localizations.router,
    all_maps_routes.router,
    loop_closures.router,
    tracks.router,
    key_routes.keys,
    key_routes.tokens,
    audit_routes.router,
    # FastAPI's dependencies for keys are of requests: a stream checks its caller itself.
    stream_routes.router,
    stream_routes.without_upgrade,
    health.router,  # health checks are unauthenticated
    stream_routes.elsewhere,  # it takes each WebSocket that no route before it takes
)
_HEADERS_OF_PAGES = (
    "Authorization",
    "Content-Digest",
    "Content-Encoding",
    "Content-Type",
    "Idempotency-Key",
    "If-Match",
    "If-None-Match",
    "If-Range",
    "Last-Event-ID",
    "Range",
    REQUEST_ID,
)
_HEADERS_FOR_PAGES = (
    *(CONTENT_DISPOSITION, CONTENT_RANGE, ETAG, LEAST_CELLS, LOCATION),
    *(LIMIT, POLICY, REQUEST_ID, RETRY_AFTER),
)


def create_app(settings: Settings | None = None, store: Store | None = None) -> FastAPI:
    """Return the application, which closes its store when it ends.

    Args:
        settings: Read from the environment if not given.
        store: The store of these settings, opened to serve; by default it is opened when the
            application starts.
    """
    chosen = settings or Settings()
    if chosen.admin_key is not None:
        hide(chosen.admin_key.get_secret_value())
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        one_blas_thread()
        pools = Pools(chosen)
        pools.size_the_default()
        service = await run_in_threadpool(_service_of, chosen, metrics, pools, store)
        app.state.service = service
        try:
            await run_in_threadpool(service.start)
            async with supervised():
                yield
        finally:
            service.begin_stop()  # a server other than ours has not called it
            closed = service.spool_room.closed(PARTS_S)
            await asyncio.gather(closed, run_in_threadpool(service.stop))

    app = FastAPIOffline(
        title="TensorMap",
        version=release(),
        description=_DESCRIPTION,
        servers=[{"url": chosen.path_prefix}] if chosen.path_prefix else None,
        lifespan=lifespan,
        separate_input_output_schemas=False,
        redirect_slashes=False,  # its Location is of the Host that was sent, without TLS of a proxy
        redoc_url=None,  # its script loads a logo from elsewhere
    )
    add_handlers(app)
    app.add_middleware(Admission)
    app.add_middleware(AuditTrail)
    app.add_middleware(UnreadBody)
    app.add_middleware(Failures)
    if chosen.allowed_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=chosen.allowed_origins,
            allow_methods=("DELETE", "GET", "HEAD", "PATCH", "POST", "PUT"),
            allow_headers=_HEADERS_OF_PAGES,
            expose_headers=_HEADERS_FOR_PAGES,
            allow_credentials=False,  # no cookies: a page sends a key that it holds
            max_age=600,
        )
    app.add_middleware(RequestObserver, metrics=metrics)  # it sees the answers of all others
    if chosen.path_prefix:
        app.add_middleware(PathPrefix, prefix=chosen.path_prefix)  # the last added is the outermost
    serve_openapi(app)
    serve_docs_page(app)
    routes = [route for router in _ROUTERS for route in router.routes]
    app.router.routes[:] = [RouteIndex([*app.router.routes, *routes]), *app.router.routes, *routes]
    complete_openapi(app)
    _expect_faults(routes, metrics)
    return app


def _expect_faults(routes: Iterable[BaseRoute], metrics: Metrics) -> None:
    """Count the 5xx that routes document from 0 on, and those of no route.

    Such requests are refused before their route is found, as while the catalog cannot be read.
    """
    for route in routes:
        if isinstance(route, APIRoute):
            for method, status in itertools.product(route.methods or (), map(int, route.responses)):
                if status >= HTTPStatus.INTERNAL_SERVER_ERROR:
                    metrics.expect(route.path, method, status)
                    metrics.expect(NO_ROUTE, method, status)


def _service_of(settings: Settings, metrics: Metrics, pools: Pools, store: Store | None) -> Service:
    """Return a service that is not started, with a first key if its store has none."""
    store = store or Store.serving(settings.data_dir, settings.catalog_url)
    try:
        make_first_key(store, settings, _show_key)
        return Service.of(settings, store, metrics, pools)
    except BaseException:
        store.close()
        raise


def _show_key(key: str) -> None:
    # The only place where a key is shown: its hash alone is stored.
    print(f"Administrator key, shown this once: {key}", flush=True)  # noqa: T201
