"""The parts of a running service: made, started, stopped; routes get them by dependencies."""

from dataclasses import dataclass
from typing import Annotated, Self

from fastapi import Depends, Request

from app.access.access import Access
from app.collector import GarbageCollector
from app.drives.drive_locks import DriveLocks
from app.ending import CLOSING_S, PARTS_S, call_all
from app.http.bodies.spool import SpoolRoom
from app.http.direct import known
from app.http.metrics import Metrics
from app.http.pools import Pools
from app.http.streams import Streams
from app.jobs.events import JobEvents
from app.jobs.runner import JobRunner
from app.localization.all_maps import AllMapsSearch
from app.localization.opened_maps import OpenedMaps
from app.localization.place_indexes import PlaceIndexes
from app.readiness import Readiness
from app.revisions.loaded import LoadedRevisions
from app.scrub import Scrub
from app.settings import Settings
from app.tracking.saver import TrackSaver
from app.tracking.tracks import Tracks
from storage.catalog import BUILD, JobRecord
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

    @classmethod
    def of(cls, settings: Settings, store: Store, metrics: Metrics, pools: Pools) -> Self:
        """Return the parts of a service of a store; none of them runs before `start`."""
        access = Access(store, settings)
        collector = GarbageCollector(settings, store)

        def ended(job: JobRecord) -> None:
            if job.kind == BUILD:
                metrics.built(job)
            else:
                # Of a capture, which stored nothing if it was not read whole.
                metrics.stored(job.result.get("stored", 0))
            collector.wake(job.map_slug)

        runner = JobRunner(settings, store, ended=ended)
        revisions = LoadedRevisions(store, settings.loaded_revisions)
        indexes = PlaceIndexes(store)
        tracks = Tracks(
            settings.max_tracks,
            settings.track_idle_s,
            settings.max_tracks_per_key,
            settings.tracked_revisions,
            saved=store.saved_tracks(),
        )
        return cls(
            settings=settings,
            store=store,
            revisions=revisions,
            all_maps=AllMapsSearch(
                store,
                OpenedMaps(revisions, settings.opened_scans),
                indexes,
                settings.max_maps_opened,
            ),
            indexes=indexes,
            runner=runner,
            access=access,
            tracks=tracks,
            track_saver=TrackSaver(tracks),
            streams=Streams(settings.max_streams, settings.max_streams_per_key),
            job_events=JobEvents(store, access),
            metrics=metrics,
            collector=collector,
            scrub=Scrub(store, metrics, settings.scrub_days),
            pools=pools,
            spool_room=SpoolRoom(settings, pools.spool),
            timed_uploads=DriveLocks(),
            readiness=Readiness(store, runner),
        )

    def start(self) -> None:
        """Start the parts with threads of their own; after an error `stop` ends those that run."""
        self.store.catalog.watch()
        self.runner.start()
        self.collector.start()
        self.scrub.start()
        self.indexes.start()
        self.track_saver.start()

    def begin_stop(self) -> None:
        """End what a stop would wait for: streams of jobs, and purges, which go on at a start.

        On the event loop; a second call has no effect.
        """
        self.job_events.end()
        self.store.purges.stop()

    def stop(self) -> None:
        """Stop every part; what fails or hangs is logged, and the others are stopped as well."""
        call_all(
            {
                "the builds": self.runner.stop,
                "the collector": self.collector.stop,
                "the scrub": self.scrub.stop,
                "the indexes": self.indexes.stop,
                "the saving of tracks": self.track_saver.stop,
            },
            PARTS_S,
        )
        call_all({"the saved tracks": self.tracks.close, "the store": self.store.close}, CLOSING_S)


async def running_service(request: Request) -> Service:
    """Return the service of a request; asynchronous, so that it needs no thread."""
    service: Service = request.app.state.service
    return service


known(running_service, running_service)
Running = Annotated[Service, Depends(running_service)]
