"""What tests do with tracks of the map `campus` of a service in this process."""

from tests.support.campus import MAP
from tests.support.recording import recording

TRACKS = f"{MAP}/tracks"


def new_track(client):
    """Create a track and return its path."""
    created = client.post(TRACKS)
    assert created.status_code == 201, created.text
    assert created.headers["Location"] == f"{TRACKS}/{created.json()['track']}"
    return created.headers["Location"]


def open_stream(client, path, **options):
    """Open a WebSocket."""
    # Starlette's client goes to its own name otherwise, whatever its base URL.
    return client.websocket_connect(f"ws://127.0.0.1{path}", **options)


def signed(basis, index):
    """Return the signatures of a scan of a second drive along the map."""
    return basis.encode(basis.image(recording(noise_seed=7).scans[index]))


def as_json(signatures):
    """Return signatures as the body of an observation."""
    shown = [
        {"segment": s.segment, "values": s.values.tolist()}
        if s.segment is not None
        else {
            "values_real": s.values.real.tolist(),
            "values_imag": s.values.imag.tolist(),
            "hidden": list(s.view.hidden),
        }
        for s in signatures
    ]
    return {"revision": signatures[0].revision, "signatures": shown}
