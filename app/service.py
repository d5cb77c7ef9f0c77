"""The parts of a running service; routes get them by dependencies."""

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request

from app.access.access import Access
from app.collector import GarbageCollector
from app.drives.drive_locks import DriveLocks
from app.http.bodies.spool import SpoolRoom
from app.http.direct import known
from app.http.metrics import Metrics
from app.http.pools import Pools
from app.http.streams import Streams
from app.jobs.events import JobEvents
from app.jobs.runner import JobRunner
from app.localization.all_maps import AllMapsSearch
from app.localization.place_indexes import PlaceIndexes
from app.readiness import Readiness
from app.revisions.loaded import LoadedRevisions
from app.scrub import Scrub
from app.settings import Settings
from app.tracking.saver import TrackSaver
from app.tracking.tracks import Tracks
from storage.store import Store


@dataclass(frozen=True)
class Service:
    """The parts of a running service.

    Attributes:
        settings: The service's settings.
        store: Maps, drives, revisions and jobs.
        revisions: The revisions that answer queries.
        all_maps: Searches all maps.
        indexes: The indexes of the places of maps with a shared basis.
        runner: Runs builds.
        access: Checks keys.
        tracks: Tracked vehicles.
        track_saver: Saves them.
        streams: Open streams.
        job_events: Events of jobs that clients follow.
        metrics: The service's metrics.
        collector: Removes what is not retained.
        scrub: Checks stored files.
        pools: Threads for requests.
        spool_room: The room for incomplete bodies.
        timed_uploads: Locks of drives, held by uploads of files that are named by times.
        readiness: What keeps it from being ready.
    """

    settings: Settings
    store: Store
    revisions: LoadedRevisions
    all_maps: AllMapsSearch
    indexes: PlaceIndexes
    runner: JobRunner
    access: Access
    tracks: Tracks
    track_saver: TrackSaver
    streams: Streams
    job_events: JobEvents
    metrics: Metrics
    collector: GarbageCollector
    scrub: Scrub
    pools: Pools
    spool_room: SpoolRoom
    timed_uploads: DriveLocks
    readiness: Readiness

    def begin_stop(self) -> None:
        """End what a stop would wait for: streams of jobs, and purges, which go on at a start.

        On the event loop; a second call has no effect.
        """
        self.job_events.end()
        self.store.purges.stop()


async def running_service(request: Request) -> Service:
    """Return the service of a request; asynchronous, so that it needs no thread."""
    service: Service = request.app.state.service
    return service


known(running_service, running_service)
Running = Annotated[Service, Depends(running_service)]
