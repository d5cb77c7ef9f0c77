// The ground below a sensor, a plane through the lowest returns: docs/reference/signature.md, levelling.
import { moved } from "./returns.js";

const HALF_SIDE = 12;
const SIDE = 2 * HALF_SIDE;
const LEAST_CELLS = 20;
const TOLERANCE_M = 0.15;

/** z = a * x + b * y + offset, in the sensor's frame. */
export class Plane {
  constructor(a, b, offset) {
    Object.assign(this, { a, b, offset });
  }

  above([x, y, z]) {
    return z - (this.a * x + this.b * y + this.offset);
  }

  get length() {
    return Math.sqrt(1 + this.a * this.a + this.b * this.b);
  }

  get depth() {
    return -this.offset * (1 / this.length);
  }
}

/** The ground around a sensor of that height, null where too little of it is seen. */
export function groundPlane(returns, heightM) {
  const cells = lowestReturns(returns);
  if (cells.length < LEAST_CELLS) return null;
  const shallowestM = Math.max(0.4 * heightM, heightM - 1.5);
  const deepestM = Math.min(2.2 * heightM, heightM + 1.5);
  let plane = consensus(cells, shallowestM, deepestM);
  for (const withinM of [0.3, 0.2, 0.15, 0.15]) {
    const near = cells.filter((cell) => Math.abs(plane.above(cell)) <= withinM);
    if (near.length < LEAST_CELLS) return null;
    plane = leastSquares(near);
  }
  return isSupported(plane, cells, heightM, shallowestM, deepestM) ? plane : null;
}

/**
 * The scan as a level sensor of that height above this plane sees it: rotated and moved, or only moved
 * where its axes are level by gravity.
 */
export function levelled(returns, plane, heightM, byGravity = false) {
  const liftM = -plane.offset - heightM;
  if (byGravity) return moved(returns, (x, y, z) => [x, y, z + liftM]);
  const [nx, ny, nz] = [-plane.a / plane.length, -plane.b / plane.length, 1 / plane.length];
  const across = 1 + nz;
  const upM = plane.depth - heightM;
  const [xx, xy, yy] = [1 - (nx * nx) / across, -(nx * ny) / across, 1 - (ny * ny) / across];
  return moved(returns, (x, y, z) => [
    xx * x + xy * y - nx * z,
    xy * x + yy * y - ny * z,
    nx * x + ny * y + nz * z + upM,
  ]);
}

// The lowest return of each cell of 2 m, without the vehicle's own cells and those too far away.
function lowestReturns(returns) {
  const lowest = new Array(SIDE * SIDE).fill(null);
  for (let at = 0; at < returns.length; at += 3) {
    const [x, y, z] = [returns[at], returns[at + 1], returns[at + 2]];
    const row = Math.floor(Math.floor(x) / 2) + HALF_SIDE;
    const column = Math.floor(Math.floor(y) / 2) + HALF_SIDE;
    if (!(row >= 0 && row < SIDE && column >= 0 && column < SIDE)) continue;
    const low = lowest[row * SIDE + column];
    const isLower =
      low === null ||
      z < low[2] ||
      (z === low[2] && (x < low[0] || (x === low[0] && y < low[1])));
    if (isLower) lowest[row * SIDE + column] = [x, y, z];
  }
  return lowest.filter((low, cell) => {
    const x = 2 * (Math.floor(cell / SIDE) - HALF_SIDE) + 1;
    const y = 2 * ((cell % SIDE) - HALF_SIDE) + 1;
    const own = Math.abs(x) < 2 && Math.abs(y) < 2;
    return low !== null && !own && x * x + y * y < SIDE * SIDE;
  });
}

const CANDIDATES = [];
for (let i = -10; i <= 10; i += 1) {
  for (let j = -10; j <= 10; j += 1) {
    if (i * i + j * j <= 100) CANDIDATES.push([i, j, i * i + j * j]);
  }
}
CANDIDATES.sort((one, other) => one[2] - other[2]); // stable

// The candidate and window with the highest score.
function consensus(cells, shallowestM, deepestM) {
  const bins = Math.max(Math.ceil((deepestM - shallowestM) * 20), 4);
  const upTo = new Int32Array(bins + 1); // how many cells are in the bins before
  let [highest, best] = [-Infinity, null];
  for (const [i, j, steep] of CANDIDATES) {
    const [a, b] = [i / 50, j / 50];
    upTo.fill(0);
    for (const [x, y, z] of cells) {
      const at = (z - (a * x + b * y) + deepestM) * 20;
      if (at >= 0 && at < bins) upTo[Math.floor(at) + 1] += 1;
    }
    for (let bin = 0; bin < bins; bin += 1) upTo[bin + 1] += upTo[bin];
    for (let k = 0; k + 4 <= bins; k += 1) {
      const under = upTo[Math.max(k - 1, 0)] - upTo[Math.max(k - 10, 0)];
      const score = 4 * (upTo[k + 4] - upTo[k]) - 6 * under - steep;
      if (score > highest) {
        highest = score;
        best = new Plane(a, b, (k + 2) / 20 - deepestM);
      }
    }
  }
  return best;
}

// Added one by one.
function sum(values) {
  return values.reduce((total, value) => total + value, 0);
}

function centred(cells) {
  const means = [0, 1, 2].map((axis) => sum(cells.map((cell) => cell[axis])) / cells.length);
  return [cells.map((cell) => cell.map((value, axis) => value - means[axis])), means];
}

// Sums of products of two coordinates.
function products(cells, pairs) {
  return pairs.map(([p, q]) => sum(cells.map((cell) => cell[p] * cell[q])));
}

function leastSquares(cells) {
  const [from, [mx, my, mz]] = centred(cells);
  const pairs = [[0, 0], [0, 1], [1, 1], [0, 2], [1, 2]];
  const [sxx, xy, syy, xz, yz] = products(from, pairs);
  const [xx, yy] = [sxx + 50, syy + 50];
  const determinant = xx * yy - xy * xy;
  const a = (yy * xz - xy * yz) / determinant;
  const b = (xx * yz - xy * xz) / determinant;
  return new Plane(a, b, mz - (a * mx + b * my));
}

// The standard deviation of cells along the direction in which it is least.
function narrowSideM(cells) {
  const [xx, xy, yy] = products(centred(cells)[0], [[0, 0], [0, 1], [1, 1]]);
  const [half, apart] = [(xx + yy) / 2, (xx - yy) / 2];
  return Math.sqrt(Math.max(half - Math.sqrt(apart * apart + xy * xy), 0) / cells.length);
}

// Whether enough of the ground is seen to trust a plane.
function isSupported(plane, cells, heightM, shallowestM, deepestM) {
  const above = cells.map((cell) => plane.above(cell));
  const near = cells.filter((_, cell) => Math.abs(above[cell]) <= TOLERANCE_M);
  if (
    near.length < LEAST_CELLS ||
    !(shallowestM <= plane.depth && plane.depth <= deepestM) ||
    plane.a * plane.a + plane.b * plane.b > 0.22 * 0.22 ||
    narrowSideM(near) < 2
  ) {
    return false;
  }
  const squares = near.map((cell) => plane.above(cell) * plane.above(cell));
  const roughM = Math.sqrt(sum(squares) / near.length);
  const higher = (heightM - plane.depth) / heightM;
  const under = above.filter((height) => height < -TOLERANCE_M).length / cells.length;
  const leastShare =
    0.15 + 2.5 * Math.max(0, higher - 0.05) + 10 * Math.max(0, roughM - 0.05) + under;
  return near.length / cells.length >= leastShare;
}
