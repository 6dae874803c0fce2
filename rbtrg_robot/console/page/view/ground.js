// The terrain as it came: tiles of 64 x 64 cells, heights, and what the body would meet on them.

const SIDE = 64,
  HEAD = 12,
  CELLS = SIDE * SIDE,
  TILE = 8 + 4 * CELLS;
export const UNKNOWN = -32768,
  NEVER = 255; // age of a cell that nothing agreed with
// Not trusted, or assumed (5).
export const doubtful = (trust) => trust <= 1 || trust === 5;

export function makeGround() {
  const tiles = new Map();
  const ground = {
    tiles,
    side: SIDE,
    res: 0.04,
    low: 0,
    high: 1,
    take,
    takeAges,
    height,
    cell,
    hit,
    body,
    dirty: new Set(),
    seen: performance.now(),
  };

  function take(data) {
    const view = new DataView(data);
    ground.res = view.getFloat32(4, true);
    if (view.getUint32(8, true)) {
      tiles.clear();
      ground.dirty.add("all");
    }
    for (let at = HEAD; at + TILE <= data.byteLength; at += TILE) {
      const row = view.getInt32(at, true),
        col = view.getInt32(at + 4, true);
      const before = tiles.get(`${row},${col}`);
      const tile = {
        row,
        col,
        height: new Int16Array(data.slice(at + 8, at + 8 + 2 * CELLS)),
        risk: new Uint8Array(data, at + 8 + 2 * CELLS, CELLS),
        trust: new Uint8Array(data, at + 8 + 3 * CELLS, CELLS),
        age: before?.age ?? new Uint8Array(CELLS).fill(NEVER),
        aged: before?.aged ?? 0,
      };
      tiles.set(`${row},${col}`, tile);
      // The meshes of the tiles before it end on its first row and column.
      for (const [dr, dc] of [
        [0, 0],
        [-SIDE, 0],
        [0, -SIDE],
        [-SIDE, -SIDE],
      ])
        ground.dirty.add(`${row + dr},${col + dc}`);
    }
    let low = Infinity,
      high = -Infinity;
    for (const tile of tiles.values())
      for (let k = 0; k < SIDE * SIDE; k += 7) {
        const h = tile.height[k];
        if (h !== UNKNOWN) {
          if (h < low) low = h;
          if (h > high) high = h;
        }
      }
    if (low <= high) {
      ground.low = low / 1000;
      ground.high = Math.max(high / 1000, low / 1000 + 0.2);
    }
  }

  // Seconds since each cell was seen, as they were when they came.
  function takeAges(data) {
    const view = new DataView(data);
    for (let at = 4; at + 8 + CELLS <= data.byteLength; at += 8 + CELLS) {
      const key = `${view.getInt32(at, true)},${view.getInt32(at + 4, true)}`,
        tile = tiles.get(key);
      if (!tile) continue;
      tile.age = new Uint8Array(data, at + 8, CELLS);
      tile.aged = performance.now();
      ground.dirty.add(key);
    }
  }

  function find(row, col) {
    const r0 = Math.floor(row / SIDE) * SIDE,
      c0 = Math.floor(col / SIDE) * SIDE;
    const tile = tiles.get(`${r0},${c0}`);
    return tile ? [tile, (row - r0) * SIDE + col - c0] : null;
  }
  function cell(x, y) {
    const found = find(Math.round(y / ground.res), Math.round(x / ground.res));
    if (!found) return null;
    const [tile, k] = found;
    return {
      z: tile.height[k] === UNKNOWN ? NaN : tile.height[k] / 1000,
      risk: tile.risk[k],
      trust: tile.trust[k],
      age: tile.age[k] === NEVER ? NaN : tile.age[k] + (performance.now() - tile.aged) / 1000,
    };
  }
  function at(row, col) {
    const found = find(row, col);
    return !found || found[0].height[found[1]] === UNKNOWN ? NaN : found[0].height[found[1]] / 1000;
  }
  // Bilinear, of the nearest cell where a neighbour is unknown; NaN on unknown ground.
  function height(x, y) {
    const u = x / ground.res,
      v = y / ground.res,
      c = Math.floor(u),
      r = Math.floor(v),
      s = u - c,
      t = v - r;
    const z =
      at(r, c) * (1 - s) * (1 - t) + at(r, c + 1) * s * (1 - t) + at(r + 1, c) * (1 - s) * t + at(r + 1, c + 1) * s * t;
    return Number.isNaN(z) ? at(Math.round(v), Math.round(u)) : z;
  }

  // Where a ray meets the ground; the plane z = flat where it meets none. Origin and direction [x, y, z].
  function hit(from, along, flat, far = 80) {
    for (let d = 0; d < far; d += 0.03) {
      const x = from[0] + d * along[0],
        y = from[1] + d * along[1],
        z = height(x, y);
      if (from[2] + d * along[2] <= z) return [x, y, z];
    }
    const d = (flat - from[2]) / along[2];
    return d > 0 && d < far ? [from[0] + d * along[0], from[1] + d * along[1], flat] : null;
  }

  // The paper's eq. 2 and 3 for one pose, on the heights that are here: sum of d_fb, a_lr and p_int in their scales; NaN unseen.
  function body(x, y, yaw, length, width) {
    const c = Math.cos(yaw),
      s = Math.sin(yaw),
      corner = { "1,1": [], "1,-1": [], "-1,1": [], "-1,-1": [] };
    const n = Math.ceil(length / 0.08) + 1,
      m = Math.ceil(width / 0.08) + 1;
    let top = -Infinity,
      known = 0;
    for (let i = 0; i < n; i++)
      for (let j = 0; j < m; j++) {
        const a = length * (i / (n - 1) - 0.5),
          b = width * (j / (m - 1) - 0.5);
        const z = height(x + c * a - s * b, y + s * a + c * b);
        if (Number.isNaN(z)) continue;
        known++;
        top = Math.max(top, z);
        if (Math.abs(a) >= length / 4 && Math.abs(b) >= width / 4) corner[`${Math.sign(a)},${Math.sign(b)}`].push(z);
      }
    if (known < (n * m) / 2) return NaN;
    const mean = (zs) => (zs.length ? zs.reduce((p, q) => p + q, 0) / zs.length : NaN);
    const [fl, fr, bl, br] = [mean(corner["1,1"]), mean(corner["1,-1"]), mean(corner["-1,1"]), mean(corner["-1,-1"])];
    if ([fl, fr, bl, br].some(Number.isNaN)) return NaN;
    const d = Math.abs((fl + fr - bl - br) / 2),
      roll = (Math.atan2(Math.abs((fl + bl - fr - br) / 2), width) * 180) / Math.PI;
    return (
      Math.min(3, d / 0.3) + Math.min(3, roll / 30) + Math.min(3, Math.max(0, top - Math.max(fl, fr, bl, br)) / 0.3)
    );
  }
  return ground;
}
