"""The examples in other languages give the outcomes of the conformance kit."""

import gzip
import io
import json
import os
import shutil
import subprocess
import tarfile
import zipfile
from html.parser import HTMLParser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

from app.localization.answers import FIX
from app.localization.query_bodies import SIGNATURE_TYPE
from tests.support.cpp import COMPILER, EXAMPLES, FAST, WITHOUT, compiled
from tests.vectors.outcomes import FOLDER

NODE = shutil.which("node")
CASES = sum(
    len(json.loads((FOLDER / f"{name}.json").read_text()))
    for name in ("signatures", "planes", "packing", "answers")
)

[NARROW] = [
    case
    for case in json.loads((FOLDER / "signatures.json").read_text())
    if (case["scan"], case["basis"]) == ("narrow", "any-views")
]
[ANSWER, *_] = json.loads((FOLDER / "answers.json").read_text())


def require_kit_held(*command: str | Path) -> None:
    done = subprocess.run([*command, FOLDER], capture_output=True, text=True, check=False)
    assert done.stdout == f"{CASES} of {CASES} cases hold\n", done.stdout + done.stderr
    assert done.returncode == 0


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The C++ program that writes the body of a query."""
    if COMPILER is None:
        pytest.skip(WITHOUT)
    return compiled("make_signature.cpp", tmp_path_factory.mktemp("cpp") / "make", "-O0")


@pytest.mark.skipif(COMPILER is None, reason=WITHOUT)
def test_the_kit_holds_in_cpp(tmp_path: Path) -> None:
    """With the flags of a vehicle: compilers make vectors of the loops then."""
    program = compiled("check_vectors.cpp", tmp_path / "check", *FAST)
    require_kit_held(program)
    absent = subprocess.run([program, "absent"], capture_output=True, check=False)
    assert (absent.returncode, absent.stderr) == (1, b"absent/signatures.json cannot be read\n")


def test_the_cpp_program_writes_the_body_of_a_query_or_says_why_not(
    program: Path, tmp_path: Path
) -> None:
    basis = FOLDER / "bases" / "any-views.json"
    command = [str(program), str(basis), str(FOLDER / "scans" / "narrow.bin"), "1.73"]
    done = subprocess.run(command, capture_output=True, check=True)
    assert done.stdout.hex() == NARROW["packed"]["int8"]
    nothing = subprocess.run(
        [program, basis, FOLDER / "scans" / "nothing.bin"], capture_output=True, check=False
    )
    assert (nothing.returncode, nothing.stdout) == (1, b"")
    assert nothing.stderr == b"no return is inside the grid, wanted metres in the sensor's frame\n"
    (tmp_path / "part.bin").write_bytes(bytes(21))
    for scan, height_m, reason in (
        (FOLDER / "scans" / "narrow.bin", "nan", "the height of the sensor is nan m, wanted above"),
        (FOLDER / "scans" / "narrow.bin", "0", "the height of the sensor is 0.000000 m, wanted"),
        (FOLDER / "scans" / "narrow.bin", "abc", "SENSOR_HEIGHT_M is 'abc', wanted a number"),
        (FOLDER / "scans" / "narrow.bin", "1.7x", "SENSOR_HEIGHT_M is '1.7x', wanted a number"),
        (os.devnull, "1.73", "no return is inside the grid"),
        (tmp_path / "part.bin", "1.73", "part.bin has 21 bytes, wanted 16 a return"),
    ):
        refused = subprocess.run([program, basis, scan, height_m], capture_output=True, check=False)
        assert (refused.returncode, refused.stdout) == (1, b"")
        assert reason in refused.stderr.decode()
    problem = tmp_path / "problem.json"
    problem.write_text('{"status": 404, "detail": "there is no map"}')
    refused = subprocess.run(
        [program, problem, tmp_path / "part.bin"], capture_output=True, check=False
    )
    assert (refused.returncode, refused.stderr) == (1, b"that is not a basis: there is no map\n")


def covered(folder: Path, by: int) -> Path:
    """Return a basis that wants as many cells as a scan of the kit has, and so many more."""
    basis = json.loads((FOLDER / "bases" / "any-views.json").read_text())
    path = folder / f"{by}.json"
    path.write_text(json.dumps(basis | {"least_cells": NARROW["occupied_cells"] + by}))
    return path


def test_the_cpp_program_refuses_a_scan_of_too_few_cells(program: Path, tmp_path: Path) -> None:
    scan = FOLDER / "scans" / "narrow.bin"
    enough, refused = (
        subprocess.run([program, covered(tmp_path, by), scan], capture_output=True, check=False)
        for by in (0, 1)
    )
    assert enough.stdout.hex() == NARROW["packed"]["int8"]
    assert (refused.returncode, refused.stdout) == (1, b"")
    assert refused.stderr.startswith(b"too few returns: %d cells" % NARROW["occupied_cells"])


@pytest.mark.skipif(NODE is None, reason="Node.js runs the JavaScript example")
def test_javascript_refuses_a_scan_of_too_few_cells(tmp_path: Path) -> None:
    program = f"""
        import {{ readFileSync }} from "node:fs";
        import {{ query, returnsOf, rowsOf }} from "{(EXAMPLES / "js" / "tensormap.js").as_uri()}";
        const [scan, ...bases] = process.argv.slice(-3);
        const returns = returnsOf(rowsOf(new Uint8Array(readFileSync(scan)).buffer), 4);
        for (const basis of bases.map((path) => JSON.parse(readFileSync(path)))) {{
            try {{ console.log(Buffer.from(query(returns, basis, 1.73)).toString("hex")); }}
            catch (error) {{ console.log(error.message); }}
        }}
    """
    files = [FOLDER / "scans" / "narrow.bin", *(covered(tmp_path, by) for by in (0, 1))]
    command = [str(NODE), "--input-type=module", "-e", program, *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    enough, refused = done.stdout.splitlines()
    assert enough == NARROW["packed"]["int8"]
    assert refused.startswith(f"too few returns: {NARROW['occupied_cells']} cells of the image")


@pytest.mark.skipif(NODE is None, reason="Node.js runs the JavaScript example")
def test_javascript_wants_to_know_how_many_numbers_a_row_has() -> None:
    program = f"""
        import {{ returnsOf }} from "{(EXAMPLES / "js" / "tensormap.js").as_uri()}";
        try {{ returnsOf([1, 2, 3, 4]); }} catch (error) {{ console.log(error.message); }}
    """
    command = [str(NODE), "--input-type=module", "-e", program]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("stride is undefined, wanted how many numbers a row has")


def on_the_page(then: str, *files: Path, answer: str = ANSWER["packed"]) -> list[str]:
    """Return what a program prints that uses the page, with its first file as the scan."""
    page = (EXAMPLES / "js" / "index.html").read_text()
    _, _, module = page.partition('<script type="module">')
    module = module.partition("</script>")[0].replace('"./', f'"{(EXAMPLES / "js").as_uri()}/')
    stubs = """
        import { readFileSync } from "node:fs";
        const [scan, basis] = process.argv.slice(-2).map((path) => readFileSync(path));
        const context = {
            createImageData: (width, height) => ({ data: new Uint8Array(4 * width * height) }),
            putImageData() {},
        };
        const fields = { map: "http://map", key: "", height: "1.73" };
        const elements = Object.fromEntries(
            Object.entries(fields).map(([name, value]) => [name, { value }])
        );
        elements.scan = { files: [{ arrayBuffer: async () => new Uint8Array(scan).buffer }] };
        const parts = {
            form: { elements, addEventListener: (_, listener) => { parts.submit = listener; } },
            pre: {},
            button: { disabled: true },
            canvas: { getContext: () => context },
        };
        globalThis.document = { querySelector: (name) => parts[name] };
        globalThis.fetch = async (url, { method = "GET" } = {}) => {
            console.log(method, url);
            return new Response(method === "GET" ? basis : Buffer.from("ANSWER", "hex"));
        };
    """.replace("ANSWER", answer)
    command = [str(NODE), "--input-type=module", "-e", stubs + module + then]
    done = subprocess.run([*command, *map(str, files)], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


class Controls(HTMLParser):
    """The attributes of a page's elements by tag, of each the first one's."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.first: dict[str, dict[str, str | None]] = {}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.first.setdefault(tag, dict(attrs))


def test_a_browser_does_not_submit_the_form_with_its_key_by_itself() -> None:
    """Where the module does not run, the key would be in the address."""
    page = (EXAMPLES / "js" / "index.html").read_text()
    first = Controls(page).first
    assert first["form"]["method"] == "dialog"
    assert "disabled" in first["button"]
    assert "JavaScript" in page.partition("<noscript>")[2].partition("</noscript>")[0]
    # What reports modules that cannot be loaded is no module itself.
    plain, module = page.partition("<script>")[2], page.index('<script type="module">')
    assert "cannot be loaded" in plain
    assert page.index("<script>") < module


@pytest.mark.skipif(NODE is None, reason="Node.js runs the JavaScript example")
def test_the_page_writes_the_answer_for_a_reader(tmp_path: Path) -> None:
    shown = """
        console.log(parts.button.disabled);
        await parts.submit({ preventDefault() {} });
        console.log(parts.pre.textContent);
    """
    files = FOLDER / "scans" / "narrow.bin", FOLDER / "bases" / "any-views.json"
    ready, _, _, *lines = on_the_page(shown, *files)
    assert ready == "false"
    assert lines == [
        f"{len(NARROW['packed']['int8']) // 2} bytes sent, 60 received",
        "Localized: scan 4711 of drive number 1, in segment 3",
        "x 612346.7 m, y -5412344.1 m, z 117.5 m, yaw 30 deg (estimated for this scan)",
        "Standard deviations: 0.75 m along, 0.3 m to the side, 2.1 deg of heading",
        "Probability 0.992, distance 0.125, ratio to the runner-up 0.5",
        "Revision 5eed5eed5eed5eed, which is live",
    ]
    packed = {
        case["name"]: case["packed"] for case in json.loads((FOLDER / "answers.json").read_text())
    }
    _, _, _, *lines = on_the_page(shown, *files, answer=packed["refused: outside_prior"])
    assert (
        lines[1]
        == "Not localized (outside_prior); nearest: scan 4711 of drive number 1, in segment 3"
    )
    _, _, _, *lines = on_the_page(shown, *files, answer=packed["nothing but a scan"])
    assert lines[2] == "Pose unknown: the map has none for this scan"
    assert lines[3] == "Standard deviations unknown"


@pytest.mark.skipif(NODE is None, reason="Node.js runs the JavaScript example")
def test_the_page_shows_that_a_scan_has_too_few_cells_and_sends_nothing(tmp_path: Path) -> None:
    shown = """
        await parts.submit({ preventDefault() {} });
        console.log(parts.pre.textContent);
    """
    fetched, refused = on_the_page(shown, FOLDER / "scans" / "narrow.bin", covered(tmp_path, 1))
    assert fetched == "GET http://map/basis"
    assert refused.startswith(f"too few returns: {NARROW['occupied_cells']} cells of the image")


@pytest.mark.skipif(NODE is None, reason="Node.js runs the JavaScript example")
def test_the_page_says_that_it_works_and_shows_no_image_of_an_earlier_scan(tmp_path: Path) -> None:
    shown = """
        const event = { preventDefault() {} };
        await parts.submit(event);
        console.log(parts.canvas.width > 0);
        elements.scan.files = [{ arrayBuffer: async () => new ArrayBuffer(21) }];
        const submitted = parts.submit(event);
        console.log(parts.pre.textContent);
        await submitted;
        console.log(parts.pre.textContent, parts.canvas.width);
    """
    files = FOLDER / "scans" / "narrow.bin", covered(tmp_path, 1)
    _, drawn, working, rejected = on_the_page(shown, *files)
    assert (drawn, working) == ("true", "Localizing ...")
    assert rejected == "21 bytes are not a whole number of 16-byte records 0"


@pytest.mark.skipif(NODE is None, reason="Node.js runs the JavaScript example")
def test_the_page_shows_nothing_of_an_earlier_scan_that_comes_after_the_last_one(
    tmp_path: Path,
) -> None:
    shown = """
        const event = { preventDefault() {} };
        let read;
        const bytes = new Promise((resolve) => { read = resolve; });
        const [last] = elements.scan.files;
        elements.scan.files = [{ arrayBuffer: () => bytes }];
        const earlier = parts.submit(event);
        elements.scan.files = [last];
        await parts.submit(event);
        console.log(parts.pre.textContent, parts.canvas.width);
        read(new ArrayBuffer(21));
        await earlier;
        console.log(parts.pre.textContent, parts.canvas.width);
    """
    _, *lines = on_the_page(shown, FOLDER / "scans" / "narrow.bin", covered(tmp_path, 1))
    assert lines[0].startswith("too few returns")
    assert lines == [lines[0]] * 2


def archives() -> dict[str, bytes]:
    """Return archives of scans whose length is a whole number of records, by kind."""
    records = (FOLDER / "scans" / "narrow.bin").read_bytes()
    packed, zipped = io.BytesIO(), io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        archive.addfile(tarfile.TarInfo("000000.bin"), io.BytesIO())
    with zipfile.ZipFile(zipped, "w") as stored:
        stored.writestr("000000.bin", records)
    bodies = {
        "zip": zipped.getvalue(),
        "gzip": gzip.compress(records),
        "tar": packed.getvalue(),
        "HDF5": b"\x89HDF\r\n\x1a\n" + bytes(56),
    }
    return {kind: body + bytes(-len(body) % 16) for kind, body in bodies.items()}


def test_the_cpp_program_rejects_archives_that_look_like_records(
    program: Path, tmp_path: Path
) -> None:
    for kind, body in archives().items():
        (tmp_path / "scan.bin").write_bytes(body)
        refused = subprocess.run(
            [program, FOLDER / "bases" / "any-views.json", tmp_path / "scan.bin"],
            capture_output=True,
            check=False,
        )
        assert (refused.returncode, refused.stdout) == (1, b""), kind
        assert f"scan.bin is a file of kind {kind}, wanted records" in refused.stderr.decode()


@pytest.mark.skipif(NODE is None, reason="Node.js runs the JavaScript example")
def test_javascript_rejects_archives_that_look_like_records() -> None:
    bodies = {kind: list(body) for kind, body in archives().items()}
    program = f"""
        import {{ rowsOf }} from "{(EXAMPLES / "js" / "tensormap.js").as_uri()}";
        for (const [kind, body] of Object.entries({json.dumps(bodies)})) {{
            try {{ rowsOf(new Uint8Array(body).buffer); console.log("taken"); }}
            catch (error) {{ console.log(error.message); }}
        }}
    """
    command = [str(NODE), "--input-type=module", "-"]
    done = subprocess.run(command, input=program, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        f"this is a file of kind {kind}, wanted records of 16 bytes" for kind in bodies
    ]


@pytest.mark.skipif(NODE is None, reason="Node.js runs the JavaScript example")
def test_the_kit_holds_in_javascript() -> None:
    require_kit_held(str(NODE), EXAMPLES / "js" / "check-vectors.js")


@pytest.mark.skipif(NODE is None, reason="Node.js runs the JavaScript example")
def test_javascript_rejects_heights_that_are_none() -> None:
    program = f"""
        import {{ imageOfScan }} from "{(EXAMPLES / "js" / "tensormap.js").as_uri()}";
        const basis = {{ parameters: {{ views: "any" }} }};
        for (const heightM of [NaN, Infinity, 0, -1, 100]) {{
            try {{ imageOfScan(new Float32Array([9, 0, 0]), basis, heightM); }}
            catch (error) {{ console.log(`${{error.name}}: ${{error.message}}`); }}
        }}
    """
    command = [str(NODE), "--input-type=module", "-e", program]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        f"RangeError: the height of the sensor is {height} m, wanted above 0 and below 100"
        for height in ("NaN", "Infinity", "0", "-1", "100")
    ]


@pytest.mark.skipif(NODE is None, reason="Node.js runs the JavaScript example")
def test_changed_outcomes_are_found(tmp_path: Path) -> None:
    shutil.copytree(FOLDER, tmp_path / "kit")
    signatures, answers = (tmp_path / "kit" / f"{name}.json" for name in ("signatures", "answers"))
    cases = json.loads(signatures.read_text())
    cases[0]["plane"][0] += 1e-17
    cases[1]["image_crc32"] = "00000000"
    cases[2]["packed"]["int8"] = cases[2]["packed"]["int8"][:-2] + "80"
    signatures.write_text(json.dumps(cases))
    known = json.loads(answers.read_text())
    known[0]["decoded"]["x_m"] += 0.125
    answers.write_text(json.dumps(known))
    command = [str(NODE), str(EXAMPLES / "js" / "check-vectors.js"), str(tmp_path / "kit")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stdout.splitlines()[-1] == f"{CASES - 4} of {CASES} cases hold"


class Service(BaseHTTPRequestHandler):
    """Has a basis, and one answer to the body that the kit says."""

    def do_GET(self) -> None:
        if self.path == "/v1/maps/campus/elsewhere/basis":
            self.send_response(302)
            self.send_header("Location", "/v1/maps/campus/basis")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        assert self.path == "/v1/maps/campus/basis"
        self._answer((FOLDER / "bases" / "any-views.json").read_bytes())

    def do_POST(self) -> None:
        sent = self.rfile.read(int(self.headers["Content-Length"]))
        kinds = self.headers["Content-Type"], self.headers["Accept"]
        expected = (SIGNATURE_TYPE, FIX.media_type, "Bearer secret", NARROW["packed"]["int8"])
        assert (*kinds, self.headers["Authorization"], sent.hex()) == expected
        self._answer(bytes.fromhex(ANSWER["packed"]))

    def _answer(self, body: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


@pytest.mark.skipif(NODE is None, reason="Node.js runs the JavaScript example")
def test_javascript_fetches_a_basis_and_localizes_a_scan() -> None:
    program = f"""
        import {{ readFileSync }} from "node:fs";
        import {{ query, returnsOf, rowsOf }} from "{(EXAMPLES / "js" / "tensormap.js").as_uri()}";
        import {{ basisOf, locate }} from "{(EXAMPLES / "js" / "service.js").as_uri()}";
        const [map, scan] = process.argv.slice(-2);
        const rows = rowsOf(new Uint8Array(readFileSync(scan)).buffer);
        const body = query(returnsOf(rows, 4), await basisOf(map, "secret"), 1.73);
        const found = await locate(map, body, "secret");
        const away = await basisOf("http://127.0.0.1:9/campus").catch((error) => error.message);
        const wrong = await basisOf(map, "schl\u00fcssel").catch((error) => error.message);
        const led = await basisOf(`${{map}}/elsewhere`).catch((error) => error.message);
        const slash = await basisOf(`${{map}}/`, "secret");
        console.log(JSON.stringify([found, away, wrong, led, slash.parameters.encoding]));
        rowsOf(new ArrayBuffer(1000));
    """
    with ThreadingHTTPServer(("127.0.0.1", 0), Service) as server:
        Thread(target=server.serve_forever).start()
        try:
            map_url = f"http://127.0.0.1:{server.server_port}/v1/maps/campus"
            command = [str(NODE), "--input-type=module", "-e", program, map_url]
            done = subprocess.run(
                [*command, FOLDER / "scans" / "narrow.bin"],
                capture_output=True,
                text=True,
                check=False,
            )
        finally:
            server.shutdown()
    assert "1000 bytes are not a whole number of 16-byte records" in done.stderr
    found, away, wrong, led, encoding = json.loads(done.stdout)
    assert found == ANSWER["decoded"]
    assert "TENSORMAP_ALLOWED_ORIGINS" in away
    assert wrong == "the key has characters that no key has: wanted printable ASCII in one line"
    assert led.endswith("/elsewhere redirects: is the address right, or does a login come first?")
    assert encoding == "harmonic"
