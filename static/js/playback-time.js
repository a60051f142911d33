/**
 * Which entry of a recording is in force at a moment. Plain functions.
 * @module
 */

/**
 * The last index whose time is not after a moment; 0 before the first one.
 * @param {number[]} times_s Rising.
 * @param {number} at_s
 */
export function indexAt(times_s, at_s) {
  let low = 0;
  let high = times_s.length;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if ((times_s[middle] ?? Infinity) <= at_s + 1e-6) low = middle;
    else high = middle;
  }
  return low;
}

/**
 * The last entry that began by a moment.
 * @template {{t_s: number}} T
 * @param {T[]} entries In the order of time.
 * @param {number} at_s
 * @returns {T | undefined}
 */
export function inForce(entries, at_s) {
  return entries.findLast((entry) => entry.t_s <= at_s + 1e-6);
}
