"""The Dockerfile and the compose file; no container engine runs here."""

import itertools
import json
import re
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCKERFILE = (ROOT / "Dockerfile").read_text()


def instructions(name: str) -> list[str]:
    whole = DOCKERFILE.replace("\\\n", " ")
    return [line.partition(" ")[2] for line in whole.splitlines() if line.startswith(f"{name} ")]


def compose() -> list[str]:
    """Return the compose file's lines, without what they are indented by."""
    text = (ROOT / "compose.yaml").read_text()
    return [line.strip() for line in text.splitlines() if line.strip()[:1] not in {"", "#"}]


def listed(name: str) -> list[str]:
    """Return the items of a list in the compose file."""
    lines = compose()
    start = lines.index(f"{name}:") + 1
    items = itertools.takewhile(lambda line: line.startswith("- "), lines[start:])
    return [item.removeprefix("- ").strip('"') for item in items]


def test_the_image_runs_as_a_user_without_rights_where_no_code_lies() -> None:
    last_stage = DOCKERFILE[DOCKERFILE.rindex("FROM ") :]
    assert re.search(r"^USER 10001:10001$", last_stage, re.MULTILINE)
    assert instructions("WORKDIR")[-1] == "/data"
    assert last_stage.index("USER ") < last_stage.index("CMD ")
    assert re.findall(r"^COPY .*", last_stage, re.MULTILINE) == [
        "COPY --from=build /opt/tensormap /opt/tensormap"
    ]


def test_the_image_serves_its_volume_on_its_port_and_checks_its_health() -> None:
    # An option: TENSORMAP_PORT would leave the port that is exposed, published and checked.
    served = '["tensormap", "serve", "--host", "0.0.0.0", "--port", "8000", "--data", "/data"]'
    assert instructions("CMD") == [served]
    assert instructions("VOLUME") == ["/data"]
    assert instructions("EXPOSE") == ["8000"]
    assert "127.0.0.1:8000/readyz" in instructions("HEALTHCHECK")[0]


def health_checks() -> list[list[str]]:
    """Return the commands that check the health of a container."""
    of_image = json.loads(instructions("HEALTHCHECK")[0].partition("CMD ")[2])
    [of_compose] = [line for line in compose() if line.startswith("test: ")]
    return [of_image, json.loads(of_compose.removeprefix("test: "))[1:]]


@pytest.mark.parametrize(("status", "code"), [(200, 0), (503, 1)])
def test_the_health_of_a_container_is_that_of_its_service_also_where_it_has_a_proxy(
    status: int, code: int
) -> None:
    class Service(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(status if self.path == "/readyz" else 404)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Service) as service:
        threading.Thread(target=service.serve_forever, daemon=True).start()
        # Docker gives a container the proxy of its client's settings; nobody is there.
        environment = {"http_proxy": "http://127.0.0.1:9", "HTTP_PROXY": "http://127.0.0.1:9"}
        for program, *words in health_checks():
            assert program == "python"
            words = [word.replace(":8000", f":{service.server_port}") for word in words]
            done = subprocess.run([sys.executable, *words], env=environment, capture_output=True)
            assert done.returncode == code, done.stderr
        service.shutdown()


def test_what_the_image_is_made_of_is_named_and_fixed() -> None:
    bases = {line.partition(" AS ")[0] for line in instructions("FROM")}
    assert bases == {"python:3.13-slim"}
    assert "PIP_CONSTRAINT=/source/constraints.txt" in DOCKERFILE
    ignored = [
        line for line in (ROOT / ".dockerignore").read_text().splitlines() if line[:1] != "#"
    ]
    assert ignored[0] == "*"
    copied = {name.strip("./") for line in instructions("COPY")[:-1] for name in line.split()[:-1]}
    assert copied == {line[1:] for line in ignored if line.startswith("!")}


_SECRET = re.compile(r"(?i)(key|secret|password|token)[a-z_]*\s*[:=][ \t]*[^\s,]")


def test_they_contain_no_secret() -> None:
    for name in ("Dockerfile", "compose.yaml", ".dockerignore"):
        text = (ROOT / name).read_text()
        assert not _SECRET.search(text), name
    assert "TENSORMAP_ADMIN_KEY:" in compose()


def test_the_postgresql_of_compose_is_the_one_that_the_catalog_is_on() -> None:
    text = (ROOT / "compose.postgresql.yaml").read_text()
    [(driver, user, password, host, database)] = re.findall(
        r"TENSORMAP_CATALOG_URL: (\S+)://(\w+):\$\{(\w+):[^}]*\}@(\w+)/(\w+)", text
    )
    assert driver == "postgresql+psycopg"
    assert f"\n  {host}:\n    image: postgres:" in text
    assert f"POSTGRES_USER: {user}\n" in text
    assert f"POSTGRES_DB: {database}\n" in text
    assert f"{password}: ${{{password}:?choose one}}" in text
    assert "[odometry,postgresql,ros]" in DOCKERFILE
    assert "ports:" not in text  # only the service reaches it


def test_compose_passes_on_every_setting_of_a_file_env_that_may_be_missing() -> None:
    lines = compose()
    start = lines.index("env_file:")
    assert lines[start + 1 : start + 3] == ["- path: .env", "required: false"]


def test_compose_takes_every_right_that_the_service_does_not_need() -> None:
    assert "read_only: true" in compose()
    assert listed("tmpfs") == ["/tmp"]
    assert listed("cap_drop") == ["ALL"]
    assert listed("security_opt") == ["no-new-privileges:true"]
    assert not any(line.startswith(("privileged", "user:", "cap_add")) for line in compose())


def test_compose_leaves_memory_and_processes_to_others_on_the_machine() -> None:
    guide = (ROOT / "docs/how-to/deploy.md").read_text()
    [limit] = re.findall(r"mem_limit: \$\{MEMORY_LIMIT:-(\d+)g\}", "\n".join(compose()))
    assert f"The container may take {limit} GB of memory" in guide
    assert "pids_limit: 1024" in compose()


def test_compose_is_reached_from_this_machine_and_keeps_its_data() -> None:
    assert listed("ports") == ["127.0.0.1:8000:8000"]
    assert listed("volumes") == ["data:/data"]
    assert "restart: unless-stopped" in compose()
    assert "/readyz" in compose()[compose().index("healthcheck:") + 1]
