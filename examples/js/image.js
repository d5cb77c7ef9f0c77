// From levelled returns to an image: heights above ground, or ranges.
import { Refused, roundEven } from "./returns.js";

export const SECTORS = 60;
const DEGREES = 180 / Math.PI;
const MOST_M = 1e30;
const LEAST_M = 2 ** -126; // smaller numbers are subnormal

const KEEP = {
  last: (kept, value) => value,
  nearest: (kept, value) => Math.min(kept, value),
  farthest: (kept, value) => Math.max(kept, value),
  highest: (kept, value) => Math.max(kept, value),
  mean: (kept) => kept,
};

/**
 * The image of returns, which are levelled if the map is of any views.
 *
 * @param {Float32Array} returns
 * @param {object} parameters Of the basis.
 * @param {number} heightM Of the sensor above ground.
 * @returns `cells` of `rows` times `columns`, metres, columns of `hidden` sectors being -1; `rings` is
 *   null if all are within reach.
 */
export function imageOf(returns, parameters, heightM) {
  const { reducer, grid } = parameters;
  const ofAnyViews = parameters.views === "any";
  const ofHeights = grid.rings !== undefined;
  const place = ofHeights ? placeOfHeights(grid, heightM) : placeOfRanges(grid);
  const { rows, columns } = shapeOf(grid);
  if (!(reducer in KEEP)) throw new Error(`the reducer is ${reducer}`);
  const cells = new Float32Array(rows * columns).fill(reducer === "nearest" ? Infinity : 0);
  const [sums, counts] = [new Float64Array(cells.length), new Int32Array(cells.length)];
  const [sees, any] = [new Uint8Array(columns), new Uint8Array(columns)];
  let [inside, largest] = [false, 0];
  for (let at = 0; at < returns.length; at += 3) {
    const [x, y, z] = [returns[at], returns[at + 1], returns[at + 2]];
    const [row, column, value] = place(x, y, z);
    if (ofAnyViews) {
      any[column] = 1;
      if (x * x + y * y > 36) sees[column] = 1;
    }
    if (!(row >= 0 && row < rows)) continue;
    const cell = row * columns + column;
    inside = true;
    largest = Math.max(largest, value);
    sums[cell] += value;
    counts[cell] += 1;
    cells[cell] = KEEP[reducer](cells[cell], Math.fround(value));
  }
  if (!inside) throw new Refused("no return is inside the grid, wanted metres in the sensor's frame");
  if (largest > MOST_M) throw new Refused("a return is beyond 1e30 m");
  for (let cell = 0; cell < cells.length; cell += 1) {
    if (reducer === "mean") cells[cell] = sums[cell] / Math.max(counts[cell], 1);
    if (cells[cell] === Infinity || cells[cell] < LEAST_M) cells[cell] = 0;
  }
  const hidden = ofAnyViews ? hide(cells, columns, visibleSectors(sees, any)) : [];
  if (!cells.some((cell) => cell > 0)) throw new Refused("no return is above the ground");
  const rings = ofAnyViews ? ringsInReach(cells, rows, columns) : null;
  return { rows, columns, cells, hidden, rings };
}

function shapeOf(grid) {
  const steps = roundEven(360 / grid.azimuth_step_deg);
  if (grid.rings !== undefined) return { rows: grid.rings, columns: steps };
  return { rows: grid.rows, columns: grid.wraps ? steps : steps + 1 };
}

function placeOfHeights(grid, heightM) {
  const steps = roundEven(360 / grid.azimuth_step_deg);
  return (x, y, z) => {
    const azimuth = roundEven((Math.atan2(y, x) * DEGREES) / grid.azimuth_step_deg);
    return [
      Math.floor(Math.sqrt(x * x + y * y) / grid.ring_m),
      azimuth < 0 ? azimuth + steps : azimuth,
      Math.max(z + heightM, 0),
    ];
  };
}

function placeOfRanges(grid) {
  const steps = roundEven(360 / grid.azimuth_step_deg);
  const lowest = grid.elevation_min_deg / grid.elevation_step_deg;
  const whole = Math.floor(lowest + 0.5);
  const fraction = lowest - whole;
  return (x, y, z) => {
    const across = Math.sqrt(x * x + y * y);
    const elevation = (Math.atan(z / across) * DEGREES) / grid.elevation_step_deg;
    const azimuth = roundEven((Math.atan2(y, x) * DEGREES) / grid.azimuth_step_deg);
    const column = azimuth + Math.floor(steps / 2);
    return [
      roundEven(elevation - fraction) - whole,
      grid.wraps ? column % steps : column,
      Math.sqrt(across * across + z * z),
    ];
  };
}

// Which sectors see: those with returns beyond 6 m in half of their columns, of few those with any.
function visibleSectors(sees, any) {
  const [wide, far, reached] = [0, 1, 2].map(() => new Array(SECTORS).fill(0));
  sees.forEach((seen, column) => {
    const sector = Math.floor((column * SECTORS) / sees.length);
    wide[sector] += 1;
    far[sector] += seen;
    reached[sector] += any[column];
  });
  const visible = far.map((count, sector) => 2 * count >= Math.max(wide[sector], 1));
  const few = visible.filter(Boolean).length < 10;
  return few ? reached.map((count) => count > 0) : visible;
}

// Marks the columns of hidden sectors and returns those sectors, rising.
function hide(cells, columns, visible) {
  const hidden = new Set();
  for (let cell = 0; cell < cells.length; cell += 1) {
    const sector = Math.floor(((cell % columns) * SECTORS) / columns);
    if (visible[sector]) continue;
    cells[cell] = -1;
    hidden.add(sector);
  }
  return [...hidden].sort((one, other) => one - other);
}

function ringsInReach(cells, rows, columns) {
  const last = Math.floor(cells.findLastIndex((cell) => cell > 0) / columns);
  return last >= 0.6 * rows || last > 15 ? null : Math.min(Math.max(last, 3), rows);
}
