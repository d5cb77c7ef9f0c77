"""Images of scans whose returns are dropped: the only copy, damaged, backed up and restored."""

import errno
import shutil
from pathlib import Path

from app.http.metrics import Metrics
from app.scrub import Scrub
from storage.backup.backup import write_backup
from storage.backup.restore import restore_backup
from storage.store import Store
from storage.store.verification import Condition, verify
from tests.support.campus import MAP, build, keep, localize
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import damage, problem_of, running, wait_for

DRIVE = f"{MAP}/drives/monday"
PLAIN = {"lateral_renderings_m": [0], "views": "full"}


def images_of(client, drive):
    store = client.service.store
    found = store.drives.get("campus", drive)
    folder = store.layout.images(found.map_id, found.id)
    return list(folder.iterdir()) if folder.exists() else []


def test_images_that_are_lost_without_returns_are_missing_and_no_backup_without_them_is_whole(
    mapped, tmp_path
):
    keep(mapped, raw_scans="drop")
    store, path = mapped.service.store, tmp_path / "backup.tar"
    write_backup(store.layout.data_dir, path)
    whole = path.read_bytes()
    (images,) = images_of(mapped, "monday")
    images.with_name("copy.h5").write_bytes(images.read_bytes())  # which no build would read
    damage(images, images.read_bytes()[:5000])
    shutil.copytree(store.layout.data_dir, tmp_path / "stopped")
    with Store(tmp_path / "stopped") as stopped:
        [finding] = verify(stopped, repair=True).findings
        assert finding.done.startswith("moved to damaged/")
        [finding] = verify(stopped).findings
        assert (finding.condition, finding.is_loss) == (Condition.MISSING, True)
        assert finding.described == "map campus, drive monday, cached images"
        Scrub(stopped, metrics := Metrics(), 1e-9).run_pass()
        assert b"tensormap_scrub_damaged_files 1.0" in metrics.render(stopped, 0)
    written = write_backup(tmp_path / "stopped", path)
    assert written.path == tmp_path / "backup.incomplete.tar"
    assert path.read_bytes() == whole  # the only copy of the images
    [missing] = written.missing
    assert missing.startswith("map campus, drive monday, cached images: the file is gone")
    restored = restore_backup(written.path, tmp_path / "new")
    assert restored.missing == written.missing
    mapped.delete(DRIVE)
    mapped.delete(f"/v1/recycle-bin/{mapped.get('/v1/recycle-bin').json()['items'][0]['entry']}")
    assert write_backup(store.layout.data_dir, path).path == path


def test_a_backup_has_the_images_that_builds_made_and_no_other_file_beside_them(mapped, tmp_path):
    keep(mapped, raw_scans="drop")
    (images,) = images_of(mapped, "monday")
    for name in ("copy.h5", f"._{images.name}"):  # the latter is of a disk of macOS
        images.with_name(name).write_bytes(images.read_bytes())
    written = write_backup(mapped.service.settings.data_dir, tmp_path / "backup.tar")
    assert (written.damaged, written.missing) == ((), ())
    restore_backup(tmp_path / "backup.tar", tmp_path / "new")
    [restored] = (tmp_path / "new").rglob("images/*")
    assert restored.name == images.name


def test_a_folder_of_images_that_cannot_be_listed_stops_no_backup(mapped, tmp_path, monkeypatch):
    keep(mapped, raw_scans="drop")
    (images,) = images_of(mapped, "monday")
    listed = Path.iterdir

    def iterdir(folder):
        if folder == images.parent:
            raise OSError(errno.EIO, "Input/output error", str(folder))
        return listed(folder)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    written = write_backup(mapped.service.settings.data_dir, tmp_path / "backup.tar")
    assert len(written.missing) == 1
    assert restore_backup(tmp_path / "backup.tar", tmp_path / "new").files == written.files


def test_returns_stay_where_images_are_missing(mapped):
    for path in images_of(mapped, "monday"):
        path.unlink()
    keep(mapped, raw_scans="drop")
    assert mapped.get(DRIVE).json()["scans_without_returns"] == 0


def test_returns_stay_where_images_are_damaged_until_a_build_projects_them_again(mapped):
    (path,) = images_of(mapped, "monday")
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x55
    damage(path, content)
    keep(mapped, raw_scans="drop")
    assert mapped.get(DRIVE).json()["scans_without_returns"] == 0
    again = build(mapped, drives=["monday"], segment_length=4, make_live=True, **PLAIN)
    assert again["state"] == "done"
    mapped.service.collector.collect()
    assert mapped.get(DRIVE).json()["scans_without_returns"] == 16


def test_damaged_images_of_dropped_returns_end_the_build_and_those_of_others_are_made_anew(mapped):
    keep(mapped, raw_scans="drop")
    build(mapped, base="live", add=["tuesday"])
    (of_monday,), (of_tuesday,) = images_of(mapped, "monday"), images_of(mapped, "tuesday")
    whole = of_monday.read_bytes()
    damage(of_tuesday, of_tuesday.read_bytes()[:5000])
    build(mapped, base="live", add=["tuesday"])
    assert of_monday.read_bytes() == whole
    damage(of_monday, whole[:5000])
    queued = mapped.post(f"{MAP}/builds", json={"base": "live", "add": ["tuesday"]}).json()
    job = wait_for(mapped, queued["job"])
    assert (job["state"], job["error"]["type"]) == ("failed", "/problems/corrupt-images")
    assert "dropped after a build" in job["error"]["detail"]
    of_monday.unlink()
    refused = mapped.post(f"{MAP}/builds", json={"base": "live", "add": ["tuesday"]})
    assert problem_of(refused) == (409, "returns-gone")


def test_a_backup_holds_what_is_kept_and_a_restore_answers(mapped, tmp_path):
    keep(mapped, raw_scans="drop")
    build(mapped, drives=["tuesday"], **PLAIN)
    done = write_backup(mapped.service.settings.data_dir, tmp_path / "backup.tar")
    assert done.damaged == ()
    restore_backup(tmp_path / "backup.tar", tmp_path / "restored")
    with running(tmp_path / "restored") as again:
        assert again.get(DRIVE).json()["scans_without_returns"] == 16
        found = localize(again, "scan", content=kitti(recording().scans[4]), headers=KITTI)
        assert found["best"]["scan_index"] == 4
        # The images are in the backup where the returns are gone, and only there.
        assert (
            images_of(again, "monday")[0].read_bytes()
            == images_of(mapped, "monday")[0].read_bytes()
        )
        assert images_of(mapped, "tuesday")
        assert not images_of(again, "tuesday")
        assert build(again, base="live", add=["tuesday"])["state"] == "done"
