// Requests of a vehicle to the service.
import { answerOf } from "./answer.js";

const SIGNATURE = "application/vnd.tensormap.signature";
const FIX = "application/vnd.tensormap.fix";

/**
 * Sends a request and returns its answer.
 *
 * @param {string} map Its address, such as http://127.0.0.1:8000/v1/maps/campus.
 * @param {string} key Empty if the service needs none.
 */
async function request(map, path, key, options) {
  if (/[^\x20-\x7e]/.test(key)) {
    throw new Error("the key has characters that no key has: wanted printable ASCII in one line");
  }
  const headers = { ...options.headers, ...(key ? { Authorization: `Bearer ${key}` } : {}) };
  const url = `${map.replace(/\/+$/, "")}/${path}`;
  // A redirection is a hotspot's or a proxy's, and is not followed: another host would get the scan.
  const answer = await fetch(url, { ...options, headers, redirect: "manual" }).catch((error) => {
    const here = globalThis.location?.origin ?? "this page"; // a browser says the same of both
    const why = `the service may be down, or its TENSORMAP_ALLOWED_ORIGINS lacks ${here}`;
    throw new Error(`${map} cannot be reached (${error.message}): ${why}`);
  });
  if (answer.ok) return answer;
  if (answer.type === "opaqueredirect" || (answer.status >= 300 && answer.status < 400)) {
    throw new Error(`${map} redirects: is the address right, or does a login come first?`);
  }
  const problem = await answer.json().catch(() => ({}));
  throw new Error(`${answer.status} ${problem.title ?? ""} ${problem.detail ?? ""}`);
}

/** The basis of the live revision: parameters, and numbers as JSON; its `least_cells` is not cached. */
export async function basisOf(map, key = "") {
  const options = { headers: { Accept: "application/json" }, cache: "no-store" };
  const answer = await request(map, "basis", key, options);
  return answer.json();
}

/** Where a packed signature was made. */
export async function locate(map, body, key = "") {
  const headers = { "Content-Type": SIGNATURE, Accept: FIX };
  const options = { method: "POST", headers, body };
  const answer = await request(map, "localizations/signature", key, options);
  return answerOf(new Uint8Array(await answer.arrayBuffer()));
}
