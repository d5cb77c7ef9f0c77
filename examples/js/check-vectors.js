// Holds the modules to the conformance kit: node check-vectors.js FOLDER, docs/reference/conformance.md.
// Prints what differs, and how many cases hold.
import { readFileSync } from "node:fs";
import { isDeepStrictEqual } from "node:util";
import * as tensormap from "./tensormap.js";

const [folder] = process.argv.slice(2);
if (!folder) {
  console.error("usage: node check-vectors.js FOLDER");
  process.exit(2);
}

const readJson = (name) => JSON.parse(readFileSync(`${folder}/${name}.json`, "utf8"));
const hex = (bytes) => Buffer.from(bytes).toString("hex");
let differences = 0;

function require(found, kept, where) {
  if (isDeepStrictEqual(found, kept)) return;
  console.log(`differs: ${where}`);
  differences += 1;
}

function crc32(values) {
  let crc = 0xffffffff;
  for (const byte of new Uint8Array(values.buffer, values.byteOffset, values.byteLength)) {
    crc ^= byte;
    for (let bit = 0; bit < 8; bit += 1) crc = crc & 1 ? (crc >>> 1) ^ 0xedb88320 : crc >>> 1;
  }
  return (~crc >>> 0).toString(16).padStart(8, "0");
}

function requireNear(found, kept, where) {
  const [one, other] = [found.flat(), kept.flat()];
  const largest = Math.max(...other.map(Math.abs));
  const near = one.every((n, i) => Math.abs(n - other[i]) <= 1e-6 * Math.abs(other[i]) + 1e-9 * largest);
  require(near && one.length === other.length, true, where);
}

function packedOr(signatures, digest, packing) {
  try {
    return hex(tensormap.packed(signatures, digest, packing));
  } catch (error) {
    if (error instanceof RangeError) return null; // beyond float16
    throw error;
  }
}

function checkScan(item) {
  const name = `${item.scan} with ${item.basis}`;
  const basis = readJson(`bases/${item.basis}`);
  const body = readFileSync(`${folder}/scans/${item.scan}.bin`);
  const rows = new Float32Array(body.buffer.slice(body.byteOffset, body.byteOffset + body.length));
  let returns = tensormap.returnsOf(rows, 4);
  const count = returns.length / 3;
  const byGravity = item.roll_deg !== null;
  if (byGravity) returns = tensormap.levelledByGravity(returns, item.roll_deg, item.pitch_deg);
  let image;
  try {
    image = tensormap.imageOfScan(returns, basis, item.sensor_height_m, byGravity);
  } catch (error) {
    if (!(error instanceof tensormap.Refused)) throw error;
    require(true, item.refused, `${name}: refused`);
    return;
  }
  require(false, item.refused, `${name}: not refused`);
  require(count, item.returns, `${name}: returns`);
  if (basis.parameters.views === "any") {
    const plane = tensormap.groundPlane(returns, item.sensor_height_m);
    require(plane && [plane.a, plane.b, plane.offset], item.plane, `${name}: plane`);
    if (plane) returns = tensormap.levelled(returns, plane, item.sensor_height_m, byGravity);
  }
  require(crc32(returns), item.levelled_crc32, `${name}: levelled returns`);
  require(crc32(image.cells), item.image_crc32, `${name}: image`);
  require(image.hidden, item.hidden, `${name}: hidden sectors`);
  require(image.rings, item.rings, `${name}: rings`);
  const signatures = tensormap.signaturesOf(image, basis);
  require(signatures.length, item.signatures.length, `${name}: signatures`);
  signatures.forEach((signature, number) => {
    const kept = item.signatures[number];
    require(signature.segment, kept.segment, `${name}: segment`);
    for (const part of ["values", "values_real", "values_imag"]) {
      if (part in kept) requireNear(signature[part], kept[part], `${name}: ${part}`);
    }
  });
  for (const [packing, digits] of Object.entries(item.packed)) {
    require(packedOr(signatures, basis.basis, packing), digits, `${name}: ${packing}`);
  }
}

function checkPlane(item) {
  const plane = tensormap.groundPlane(tensormap.returnsOf(item.returns_m.flat(), 3), item.sensor_height_m);
  require(plane && [plane.a, plane.b, plane.offset], item.plane, `plane of ${item.sensor_height_m}`);
}

function checkPacking(item) {
  require(packedOr(item.signatures, item.basis, item.packing), item.packed, item.name);
}

function checkAnswer(item) {
  const bytes = Uint8Array.from(Buffer.from(item.packed, "hex"));
  require(tensormap.answerOf(bytes), item.decoded, item.name);
}

let [checked, failed] = [0, 0];
for (const [name, check] of [
  ["signatures", checkScan],
  ["planes", checkPlane],
  ["packing", checkPacking],
  ["answers", checkAnswer],
]) {
  for (const item of readJson(name)) {
    const before = differences;
    check(item);
    checked += 1;
    failed += differences > before ? 1 : 0;
  }
}
console.log(`${checked - failed} of ${checked} cases hold`);
process.exit(failed > 0 || checked === 0 ? 1 : 0);
