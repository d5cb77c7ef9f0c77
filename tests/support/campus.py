"""What tests do with the map `campus` of a service in this process."""

from app.revisions.schemas import BasisOut
from core.encodings.signature import pack_signatures
from tests.support.recording import recording
from tests.support.service import wait_for

MAP = "/v1/maps/campus"
BUILDS = f"{MAP}/builds"
IMAGE = {"Content-Type": "application/vnd.tensormap.image"}
PACKED = {"Content-Type": "application/vnd.tensormap.signature"}
NPZ = {"Accept": "application/vnd.tensormap.basis+npz"}


def queue_build(client, **parameters):
    """Queue a build and return its job's id."""
    queued = client.post(BUILDS, json=parameters)
    assert queued.status_code == 202, queued.text
    return queued.json()["job"]


def build(client, **parameters):
    """Build a revision and return its job, which is done."""
    job = wait_for(client, queue_build(client, **parameters))
    assert job["state"] == "done", job
    return job


def basis_of(client, **params):
    """Return the basis that the map's live revision, or another one, has."""
    return BasisOut.model_validate(client.get(f"{MAP}/basis", params=params).json()).to_core()


def localize(client, kind, *, content=None, headers=None, **options):
    """Return the answer to a scan, an image or signatures."""
    response = client.post(
        f"{MAP}/localizations/{kind}", content=content, headers=headers, **options
    )
    assert response.status_code == 200, response.text
    return response.json()


def signed(client, revision):
    """Return scan 20's packed signatures, made with the basis of a revision."""
    basis = basis_of(client, revision=revision)
    return pack_signatures(basis.encode(basis.image(recording().scans[20])))


def localize_packed(client, signature, slug="campus"):
    """Return the response to packed signatures."""
    return client.post(
        f"/v1/maps/{slug}/localizations/signature", content=signature, headers=PACKED
    )


def keep(client, **retention):
    """Set the retention policy, and collect what it lets go."""
    changed = client.patch(MAP, json={"retention": retention})
    assert changed.status_code == 200, changed.text
    client.service.collector.collect()
    return changed.json()


def acts(client):
    """Return who did what, and how, newest first."""
    page = client.service.store.audit.list(limit=1000)
    return [(entry.key_id, entry.action, entry.detail) for entry in page.items]
