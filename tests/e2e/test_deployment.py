"""The files of `deploy/`, as the programs that read them see them."""

import os
import re
import shlex
import shutil
import socket
import ssl
import subprocess
from contextlib import contextmanager
from pathlib import Path

import httpx2
import pytest
import uvicorn
from websockets.sync.client import connect

from app.settings import Settings
from tests.support.commands import ROOT
from tests.support.process import serving, until
from tests.support.recording import KITTI, kitti, recording
from tests.support.service import problem_of, upload, wait_for

KEY = "correct-horse-battery-staple"
UNIT = (ROOT / "deploy/tensormap.service").read_text()
NGINX = (ROOT / "deploy/nginx.conf").read_text()
needs_nginx = pytest.mark.skipif(
    shutil.which("nginx") is None or shutil.which("openssl") is None,
    reason="nginx or openssl is not installed",
)


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        return int(listening.getsockname()[1])


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_finds_nothing_wrong_with_the_unit(tmp_path):
    unit = tmp_path / "tensormap.service"
    unit.write_text(UNIT.replace("/opt/tensormap/bin/tensormap", "/bin/true"))
    done = subprocess.run(
        ["systemd-analyze", "verify", unit], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert not [line for line in done.stderr.splitlines() if "tensormap" in line]


def unit_of_the_night() -> str:
    """Return the guide's unit that backs up and copies the backup."""
    guide = (ROOT / "docs/how-to/deploy.md").read_text()
    [unit] = re.findall(r"```ini\n(# \S+/tensormap-backup\.service\n.+?)```", guide, re.DOTALL)
    return str(unit)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_finds_nothing_wrong_with_the_unit_of_the_night(tmp_path):
    unit = tmp_path / "tensormap-backup.service"
    unit.write_text(unit_of_the_night())
    done = subprocess.run(
        ["systemd-analyze", "verify", unit], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert not [line for line in done.stderr.splitlines() if "tensormap" in line]


@pytest.mark.parametrize(
    ("made", "copied", "status"), [(0, 0, 0), (1, 0, 1), (0, 23, 23), (1, 23, 23)]
)
def test_the_unit_of_the_night_copies_an_incomplete_backup_too_and_fails(
    tmp_path, made, copied, status
):
    """What systemd does with the line: `\\` joins lines, quotes make one argument, `$$` is `$`."""
    [line] = re.findall(r"^ExecStart=(.+?[^\\])$", unit_of_the_night(), re.MULTILINE | re.DOTALL)
    shell, option, command = shlex.split(line.replace("\\\n", " ").replace("$$", "$"))
    backup, rsync = tmp_path / "tensormap", tmp_path / "rsync"
    backup.write_text(
        f"#!/bin/sh\ntouch {tmp_path}/backup.tar {tmp_path}/backup.incomplete.tar; exit {made}\n"
    )
    rsync.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/copied; exit {copied}\n')
    for program in (backup, rsync):
        program.chmod(0o700)
    for path, own in (
        ("/opt/tensormap/bin/tensormap", backup),
        ("/usr/bin/rsync", rsync),
        ("/var/lib/tensormap", tmp_path),
    ):
        assert path in command
        command = command.replace(path, str(own))
    done = subprocess.run([shell, option, command], timeout=60)
    assert done.returncode == status
    names = (tmp_path / "copied").read_text().split()
    files = [str(tmp_path / f"backup.{kind}tar") for kind in ("incomplete.", "")]
    assert names == ["--archive", *files, "backup.example:tensormap/"]


def test_the_unit_has_the_service_watched_and_its_files_private():
    lines = set(UNIT.splitlines())
    assert {"Type=notify", "WatchdogSec=30", "UMask=0077", "LimitNOFILE=65536"} <= lines
    assert "Restart=on-failure" in lines  # which a watchdog's end is


def test_the_unit_takes_what_the_service_does_not_need():
    lines = UNIT.splitlines()
    assert {"PrivateUsers=yes", "ProtectProc=invisible", "RemoveIPC=yes"} <= set(lines)
    allowed = lines.index("SystemCallFilter=@system-service")
    assert lines[allowed + 1] == "SystemCallFilter=~@privileged"
    assert "@resources" not in "".join(line for line in lines if line[:1] != "#")
    assert not any(line.startswith("MemoryDenyWriteExecute") for line in lines)  # numba compiles


def test_the_unit_runs_the_command_of_the_guide_and_gives_a_build_time_to_be_queued():
    guide = (ROOT / "docs/how-to/deploy.md").read_text()
    [command] = re.findall(r"^ExecStart=(\S+) serve --data (\S+)$", UNIT, re.MULTILINE)
    for path in (*command, "/etc/tensormap/environment"):
        assert path in guide
    assert "KillMode=mixed" in UNIT  # a signal to the group would reach builds too


def test_the_guide_installs_the_extras_that_the_image_has():
    guide = (ROOT / "docs/how-to/deploy.md").read_text()
    [of_image] = re.findall(
        r"tensormap_server-\S+\)\[([a-z,-]+)\]", (ROOT / "Dockerfile").read_text()
    )
    installs = re.findall(r"pip install [^\n]*'\.\[([a-z,-]+)\]'", guide)
    assert installs == [of_image, of_image]  # when it is deployed and when it is upgraded


def test_the_guide_lets_the_services_user_read_what_root_installs_with_any_umask():
    guide = (ROOT / "docs/how-to/deploy.md").read_text()
    installed = re.findall(r"/pip install [^\n]*\n(.*)$", guide, re.MULTILINE)
    assert len(installed) == 2
    assert all(line.startswith("sudo chmod -R a+rX /opt/tensormap") for line in installed)


@contextmanager
def proxied(folder: Path, service_port: int, prefix: str = ""):
    """Run nginx with our file: its ports, name, certificate, folders and prefix are the test's."""
    folder.mkdir()
    if os.geteuid() == 0:
        folder.chmod(0o755)
    port, plain = free_port(), free_port()
    made = ["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
            "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-days", "2",
            "-keyout", "privkey.pem", "-out", "fullchain.pem"]  # fmt: skip
    subprocess.run(["openssl", *made], cwd=folder, check=True, capture_output=True, timeout=60)
    site = (
        NGINX.replace("listen 80;", f"listen 127.0.0.1:{plain};")
        .replace("listen 443 ssl;", f"listen 127.0.0.1:{port} ssl;")
        .replace("maps.example;", "localhost;")
        .replace("/etc/ssl/tensormap", str(folder))
        .replace("127.0.0.1:8000", f"127.0.0.1:{service_port}")
        .replace("location / {", f"location {prefix}/ {{")
        .replace("location ~ ^/", f"location ~ ^{prefix}/")
        .replace("location = /", f"location = {prefix}/")
    )
    (folder / "site.conf").write_text(site)
    kept = "".join(
        f"{name}_temp_path {folder}/{name};\n"
        for name in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    user = "user root;\n" if os.geteuid() == 0 else ""
    (folder / "nginx.conf").write_text(
        f"{user}daemon off;\nmaster_process off;\npid {folder}/pid;\n"
        f"error_log {folder}/error.log;\n"
        f"events {{}}\nhttp {{\naccess_log {folder}/access.log;\n{kept}include site.conf;\n}}\n"
    )
    command = ["nginx", "-p", str(folder), "-c", str(folder / "nginx.conf")]
    checked = subprocess.run([*command, "-t"], capture_output=True, text=True, timeout=60)
    assert checked.returncode == 0, checked.stderr
    assert "warn" not in checked.stderr, checked.stderr
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    try:
        until(lambda: answers(port), "nginx does not answer")
        trusted = ssl.create_default_context(cafile=str(folder / "fullchain.pem"))
        yield port, plain, trusted
    finally:
        process.terminate()
        process.wait(30)


def answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=5).close()
    except OSError:
        return False
    return True


def test_nginx_closes_an_idle_connection_before_the_service_does():
    [kept_s] = re.findall(r"^ *keepalive_timeout +(\d+)s;", NGINX, re.MULTILINE)
    assert int(kept_s) < uvicorn.Config("", log_config=None).timeout_keep_alive


@pytest.mark.parametrize("of", ["read", "send"])
def test_nginx_does_not_cut_off_what_waits_for_longer_than_its_minute(of):
    assert re.findall(rf"^ *proxy_{of}_timeout +(\S+);", NGINX, re.MULTILINE) == ["1h"]


@needs_nginx
@pytest.mark.parametrize("prefix", ["", "/tensormap"])
def test_the_service_works_behind_nginx_with_tls_and_a_key(tmp_path, prefix):
    log = tmp_path / "log"
    with (
        serving(tmp_path / "data", log, admin_key=KEY, path_prefix=prefix) as server,
        proxied(tmp_path / "nginx", server.port, prefix) as (port, plain, trusted),
    ):
        url = f"https://localhost:{port}{prefix}"
        with httpx2.Client(base_url=url, verify=trusted, timeout=60) as anyone:
            refused = anyone.get("/v1/maps")
            assert problem_of(refused) == (401, "key-needed")
            assert len(refused.headers["X-Request-Id"]) == 32  # nginx's own
            assert refused.headers["Strict-Transport-Security"]
            assert anyone.get("/readyz").status_code == 200
            assert anyone.get("/metrics").status_code == 404
            moved = httpx2.get(
                f"http://127.0.0.1:{plain}/v1/maps?a=b", headers={"Host": "localhost"}
            )
            assert (moved.status_code, moved.headers["Location"]) == (
                308,
                "https://localhost/v1/maps?a=b",
            )
        bearer = {"Authorization": f"Bearer {KEY}"}
        with httpx2.Client(base_url=url, verify=trusted, headers=bearer, timeout=60) as client:
            assert client.post("/v1/maps", json={"map": "campus"}).status_code == 201
            upload(client, "monday", recording(scans=8))
            job = client.post("/v1/maps/campus/builds", json={"segments": 1}).json()["job"]
            assert wait_for(client, job)["state"] == "done"
            body = kitti(recording(scans=8).scans[5])
            found = client.post("/v1/maps/campus/localizations/scan", content=body, headers=KITTI)
            assert found.json()["best"]["scan_index"] == 5
            most = Settings.model_fields["max_body_bytes"].default
            large = client.post(
                "/v1/maps/campus/localizations/scan", content=bytes(most + 1), headers=KITTI
            )
            assert large.status_code == 413
            track = client.post("/v1/maps/campus/tracks").json()["track"]
        stream = f"wss://localhost:{port}{prefix}/v1/maps/campus/tracks/{track}/stream"
        with connect(stream, ssl=trusted, additional_headers=bearer) as opened:
            opened.send("{}")
            assert "/problems/invalid-request" in str(opened.recv(timeout=30))


def test_the_guide_and_nginx_pass_on_as_large_a_body_as_the_service_reads():
    [megabytes] = re.findall(r"client_max_body_size\s+(\d+)m;", NGINX)
    assert int(megabytes) * 2**20 == Settings.model_fields["max_body_bytes"].default
