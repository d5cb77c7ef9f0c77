// From an image to signatures, and their packed bytes.
import { SECTORS } from "./image.js";
import { roundEven } from "./returns.js";

const LARGEST_FLOAT16 = 65504;

/** The signatures of an image as they are in JSON: one in a harmonic map, else one of each segment. */
export function signaturesOf(image, basis) {
  if (basis.parameters.encoding === "harmonic") return [harmonicSignature(image, basis)];
  if (basis.parameters.encoding !== "paper") {
    throw new Error(`the basis is of encoding ${basis.parameters.encoding}`);
  }
  return basis.segments.map((segment) => paperSignature(image, segment));
}

// G = U^T S F, in as many numbers as the basis asks for of such a view.
function harmonicSignature(image, basis) {
  const u = basis.radial_basis;
  let [r1, r2] = basis.parameters.ranks;
  const isNarrow = 3 * image.hidden.length >= SECTORS || image.rings !== null;
  if (basis.parameters.views === "any" && isNarrow && r2 > Math.max(r1, 6)) {
    r1 = Math.min(r1 + 2, u[0].length);
    r2 -= 2;
  }
  const { columns, cells } = image;
  const turn = (2 * Math.PI) / columns;
  const norm = Math.sqrt(columns);
  const cosine = Float64Array.from({ length: columns }, (_, k) => Math.cos(turn * k) / norm);
  const sine = Float64Array.from({ length: columns }, (_, k) => Math.sin(turn * k) / norm);
  const [real, imag] = [[], []];
  for (let r = 0; r < r1; r += 1) {
    const radial = new Float64Array(columns);
    for (let i = 0; i < (image.rings ?? image.rows); i += 1) {
      for (let j = 0; j < columns; j += 1) {
        radial[j] += u[i][r] * Math.max(cells[i * columns + j], 0);
      }
    }
    real.push([]);
    imag.push([]);
    for (let m = 0; m < r2; m += 1) {
      let [re, im] = [0, 0];
      for (let j = 0; j < columns; j += 1) {
        const k = (m * j) % columns;
        re += radial[j] * cosine[k];
        im -= radial[j] * sine[k];
      }
      real[r].push(Math.fround(re));
      imag[r].push(m === 0 ? 0 : Math.fround(im));
    }
  }
  const { hidden, rings } = image;
  return { segment: null, hidden, rings, values_real: real, values_imag: imag };
}

// G = U^T S V of one segment.
function paperSignature(image, basis) {
  const [u, v] = [basis.elevation_basis, basis.azimuth_basis];
  const values = u[0].map((_, r) => {
    const reduced = new Float64Array(image.columns);
    for (let i = 0; i < image.rows; i += 1) {
      for (let j = 0; j < image.columns; j += 1) {
        reduced[j] += u[i][r] * image.cells[i * image.columns + j];
      }
    }
    return v[0].map((__, m) => Math.fround(reduced.reduce((sum, n, j) => sum + n * v[j][m], 0)));
  });
  return { segment: basis.segment, hidden: [], rings: null, values };
}

/**
 * The packed bytes of a scan's signatures.
 *
 * @param {object[]} signatures As in JSON.
 * @param {string} digest Of the basis.
 * @param {"int8" | "float16"} packing Those of the paper are always float16, or float32 where one is
 *   beyond that.
 * @returns {Uint8Array}
 */
export function packed(signatures, digest, packing = "int8") {
  const [first] = signatures;
  const harmonic = first.segment === null;
  const rows = first.values ?? first.values_real;
  const numbers = signatures.map(harmonic ? numbersOfHarmonic : ({ values }) => values.flat());
  const beyond = numbers.flat().some((number) => Math.abs(number) > LARGEST_FLOAT16);
  const partial = first.hidden.length > 0 || first.rings !== null;
  let layout = beyond ? 2 : 1;
  if (harmonic && packing === "int8") layout = partial ? 5 : 4;
  else if (harmonic && beyond) throw new RangeError("a number is beyond float16");
  else if (harmonic) layout = partial ? 6 : 3;
  const writer = new Writer();
  writer.put(1, layout);
  for (let at = 0; at < 16; at += 2) writer.put(1, parseInt(digest.slice(at, at + 2), 16));
  writer.put(1, rows.length);
  writer.put(1, rows[0].length);
  signatures.forEach(({ segment }, number) => {
    if (!harmonic) writer.put(2, segment);
    if (partial) writer.putView(first.hidden, first.rings);
    if (layout === 4 || layout === 5) writer.putInt8(numbers[number], partial);
    else if (layout === 2) numbers[number].forEach((value) => writer.put(4, float32Bits(value)));
    else numbers[number].forEach((value) => writer.put(2, float16Bits(value)));
  });
  return Uint8Array.from(writer.bytes);
}

// The first column, then real and imaginary parts of the others.
function numbersOfHarmonic({ values_real: real, values_imag: imag }) {
  const others = [real, imag].map((part) => part.map((row) => row.slice(1)));
  return [real.map((row) => row[0]), others].flat(3);
}

// Little-endian.
class Writer {
  bytes = [];

  put(count, bits) {
    for (let byte = 0; byte < count; byte += 1) this.bytes.push((bits >>> (8 * byte)) & 0xff);
  }

  putView(hidden, rings) {
    let bits = BigInt(rings ?? 0) << BigInt(SECTORS);
    for (const sector of hidden) bits |= 1n << BigInt(sector);
    this.put(4, Number(bits & 0xffffffffn));
    this.put(4, Number(bits >> 32n));
  }

  // A scale, and the rounded root of each number.
  putInt8(numbers, partial) {
    const largest = numbers.reduce((most, number) => Math.max(most, Math.abs(number)), 0);
    let bits = float32Bits(largest / 16129);
    if (partial) bits = ((bits + 0xffff) & ~0xffff) >>> 0;
    const scale = float32Of(bits);
    this.put(partial ? 2 : 4, partial ? bits >>> 16 : bits);
    for (const number of numbers) {
      const root = scale > 0 ? roundEven(Math.sqrt(Math.abs(number) / scale)) : 0;
      this.put(1, Math.sign(number) * Math.min(root, 127));
    }
  }
}

const view = new DataView(new ArrayBuffer(4));

function float32Bits(value) {
  view.setFloat32(0, value);
  return view.getUint32(0);
}

function float32Of(bits) {
  view.setUint32(0, bits);
  return view.getFloat32(0);
}

// To the nearest, halves to even; up to 65504.
function float16Bits(value) {
  const sign = value < 0 || Object.is(value, -0) ? 0x8000 : 0;
  let exponent = -14;
  while (2 ** (exponent + 1) <= Math.abs(value)) exponent += 1;
  const steps = roundEven(Math.abs(value) * 2 ** (10 - exponent));
  return sign | ((exponent + 14) * 1024 + steps);
}
