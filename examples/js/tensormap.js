// Signatures of LiDAR scans for TensorMap, without dependencies: an ES module for browsers and Node.
import { groundPlane, levelled } from "./ground.js";
import { imageOf } from "./image.js";
import { Refused, returnsOf } from "./returns.js";
import { packed, signaturesOf } from "./signature.js";

export { ANSWER_BYTES, answerOf } from "./answer.js";
export { groundPlane, levelled, imageOf, packed, Refused, returnsOf, signaturesOf };
export { levelledByGravity, rowsOf } from "./returns.js";

/** The image of a scan as the map of a basis wants it: levelled if that is of any views. */
export function imageOfScan(returns, basis, heightM, byGravity = false) {
  if (!(heightM > 0 && heightM < 100)) {
    throw new RangeError(`the height of the sensor is ${heightM} m, wanted above 0 and below 100`);
  }
  if (returns.length === 0) throw new Refused("no row is a return");
  const plane = basis.parameters.views === "any" ? groundPlane(returns, heightM) : null;
  const level = plane ? levelled(returns, plane, heightM, byGravity) : returns;
  return imageOf(level, basis.parameters, heightM);
}

/**
 * The body of a query: `POST /v1/maps/{map}/localizations/signature`, with the media type
 * application/vnd.tensormap.signature. Throws `Refused` if fewer cells than `least_cells` are occupied.
 *
 * @param {Float32Array} returns
 * @param {object} basis As `GET /v1/maps/{map}/basis` answers it.
 * @param {number} heightM Of the sensor above ground.
 */
export function query(returns, basis, heightM = basis.parameters.sensor_height_m) {
  const image = imageOfScan(returns, basis, heightM);
  const occupied = image.cells.reduce((count, metres) => count + (metres > 0), 0);
  const least = basis.least_cells ?? 0;
  if (occupied < least) {
    const wanted = `the map wants at least ${least}`;
    throw new Refused(`too few returns: ${occupied} cells of the image are occupied, ${wanted}`);
  }
  return packed(signaturesOf(image, basis), basis.basis);
}
