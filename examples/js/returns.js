// Returns of a scan, and how they are rotated level by gravity.

/** There is no signature: nothing, or too little, of the scan is above ground and inside the grid. */
export class Refused extends Error {}

/** Rounds to a whole number, halves to the even one. */
export function roundEven(value) {
  const low = Math.floor(value);
  const rest = value - low;
  if (rest !== 0.5) return rest < 0.5 ? low : low + 1;
  return low % 2 === 0 ? low : low + 1;
}

// Puts a return behind `kept` others in `xyz`, if it is one; returns how many there are then.
function put(xyz, kept, x, y, z) {
  const at = 3 * kept;
  xyz[at] = x; // rounded to float32
  xyz[at + 1] = y;
  xyz[at + 2] = z;
  const finite =
    Number.isFinite(xyz[at]) && Number.isFinite(xyz[at + 1]) && Number.isFinite(xyz[at + 2]);
  return finite && (xyz[at] !== 0 || xyz[at + 1] !== 0 || xyz[at + 2] !== 0) ? kept + 1 : kept;
}

const CONTAINERS = [
  ["zip", 0, "PK\x03\x04"],
  ["gzip", 0, "\x1f\x8b\x08"],
  ["HDF5", 0, "\x89HDF\r\n\x1a\n"],
  ["tar", 257, "ustar"],
];

// Records have no beginning of their own, and archives may be a whole number of them.
function containerOf(bytes) {
  const found = CONTAINERS.find(([, at, magic]) =>
    [...magic].every((letter, i) => bytes[at + i] === letter.charCodeAt(0)),
  );
  // The fourth byte of a coordinate that begins like gzip is not one of its flags.
  return found?.[0] === "gzip" && bytes[3] > 0x1f ? undefined : found?.[0];
}

/** The numbers of a scan in KITTI's format: x, y, z and intensity of each return. */
export function rowsOf(buffer) {
  const kind = containerOf(new Uint8Array(buffer, 0, Math.min(buffer.byteLength, 512)));
  if (kind) throw new Error(`this is a file of kind ${kind}, wanted records of 16 bytes`);
  if (buffer.byteLength % 16 !== 0) {
    throw new Error(`${buffer.byteLength} bytes are not a whole number of 16-byte records`);
  }
  return new Float32Array(buffer);
}

/**
 * The rows that are returns, in their order, as x, y, z of each in one Float32Array.
 *
 * @param {ArrayLike<number>} rows Metres in the sensor's frame: x forward, y left, z up.
 * @param {number} stride Numbers from one row to the next: 4 of KITTI's files.
 * @throws {RangeError} Without a stride of at least 3.
 */
export function returnsOf(rows, stride) {
  if (!Number.isInteger(stride) || stride < 3) {
    throw new RangeError(`stride is ${stride}, wanted how many numbers a row has, at least 3`);
  }
  const xyz = new Float32Array(3 * Math.floor(rows.length / stride));
  let kept = 0;
  for (let at = 0; at + stride <= rows.length; at += stride) {
    kept = put(xyz, kept, rows[at], rows[at + 1], rows[at + 2]);
  }
  return xyz.subarray(0, 3 * kept);
}

/** What `move(x, y, z)` makes of returns: `[x, y, z]`. */
export function moved(returns, move) {
  const xyz = new Float32Array(returns.length);
  let kept = 0;
  for (let at = 0; at < returns.length; at += 3) {
    kept = put(xyz, kept, ...move(returns[at], returns[at + 1], returns[at + 2]));
  }
  return xyz.subarray(0, 3 * kept);
}

/** R = Ry(pitch) Rx(roll), for a vehicle that measures gravity. */
export function levelledByGravity(returns, rollDeg, pitchDeg) {
  const [cr, sr] = [Math.cos((rollDeg * Math.PI) / 180), Math.sin((rollDeg * Math.PI) / 180)];
  const [cp, sp] = [Math.cos((pitchDeg * Math.PI) / 180), Math.sin((pitchDeg * Math.PI) / 180)];
  return moved(returns, (x, y, z) => [
    cp * x + sp * sr * y + sp * cr * z,
    cr * y - sr * z,
    -sp * x + cp * sr * y + cp * cr * z,
  ]);
}
