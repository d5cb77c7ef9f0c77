// A packed answer of 60 bytes: docs/reference/http-api.md.

export const ANSWER_BYTES = 60;
const REASONS = [
  null,
  "unknown_place",
  "ambiguous",
  "too_few_returns",
  "outside_prior",
  "not_calibrated",
];

/** What an answer says; what is not known is null. */
export function answerOf(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, ANSWER_BYTES);
  if (view.getUint8(0) !== 1) throw new Error(`the answer's layout is ${view.getUint8(0)}`);
  const flags = view.getUint8(1);
  const known = (number) => (Number.isNaN(number) ? null : number);
  const single = (at) => known(view.getFloat32(at, true));
  const half = (at) => known(float16Of(view.getUint16(at, true)));
  return {
    localized: (flags & 1) !== 0,
    of_live: (flags & 2) !== 0,
    estimated: (flags & 4) !== 0,
    reason: REASONS[flags >> 4],
    segment: view.getUint16(2, true),
    drive: view.getUint16(4, true),
    scan_index: view.getUint32(6, true),
    revision: Array.from(bytes.subarray(10, 18), (byte) => byte.toString(16).padStart(2, "0")).join(""),
    probability: single(18),
    distance: single(22),
    ratio: single(26),
    z_m: single(30),
    yaw_deg: single(34),
    along_std_m: half(38),
    lateral_std_m: half(40),
    heading_std_deg: half(42),
    x_m: known(view.getFloat64(44, true)),
    y_m: known(view.getFloat64(52, true)),
  };
}

function float16Of(bits) {
  const sign = bits >> 15 ? -1 : 1;
  const [exponent, steps] = [(bits >> 10) & 31, bits & 1023];
  if (exponent === 31) return steps ? NaN : sign * Infinity;
  return sign * (exponent ? 1024 + steps : steps) * 2 ** (Math.max(exponent, 1) - 25);
}
