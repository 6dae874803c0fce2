// What stands on the terrain, as triangles for the 3D view: x, y, z, colour. The 2D view draws the same world by itself.

import { COLOUR } from "./palette.js";

// From 0 to 1.2: green, amber, red. Also told in words and figures elsewhere.
export function risky(risk, alpha = 255) {
  if (Number.isNaN(risk)) return [130, 130, 140, alpha];
  const t = Math.max(0, Math.min(1, risk / 1.2));
  return t < 0.5 ? [40 + 400 * t, 165, 90 - 100 * t, alpha] : [240, 165 - 290 * (t - 0.5), 40, alpha];
}

export function makeShapes() {
  const at = [],
    colour = [];
  const shapes = { at, colour, ribbon, box, disc, line3 };
  function triangle(a, b, c, paint) {
    at.push(...a, ...b, ...c);
    for (let k = 0; k < 3; k++) colour.push(...paint);
  }
  function quad(a, b, c, d, paint) {
    triangle(a, b, c, paint);
    triangle(a, c, d, paint);
  }

  // A band over points [x, y, z], wide [m], with its casing; `paint` of each piece.
  function ribbon(points, wide, paint, { dash = 0, lift = 0.05, cased = true } = {}) {
    if (cased) ribbon(points, 1.7 * wide, COLOUR.casing, { dash, lift: lift - 0.012, cased: false });
    let run = 0;
    for (let k = 0; k + 1 < points.length; k++) {
      const [a, b] = [points[k], points[k + 1]],
        dx = b[0] - a[0],
        dy = b[1] - a[1],
        n = Math.hypot(dx, dy);
      if (!n || Number.isNaN(a[2] + b[2])) continue;
      run += n;
      if (dash && Math.floor(run / dash) % 2) continue;
      const ox = ((-dy / n) * wide) / 2,
        oy = ((dx / n) * wide) / 2;
      quad(
        [a[0] + ox, a[1] + oy, a[2] + lift],
        [b[0] + ox, b[1] + oy, b[2] + lift],
        [b[0] - ox, b[1] - oy, b[2] + lift],
        [a[0] - ox, a[1] - oy, a[2] + lift],
        typeof paint === "function" ? paint(k) : paint,
      );
    }
  }
  // A line through the air: two crossed bands.
  function line3(a, b, wide, paint) {
    const w = wide / 2;
    quad([a[0] - w, a[1], a[2]], [a[0] + w, a[1], a[2]], [b[0] + w, b[1], b[2]], [b[0] - w, b[1], b[2]], paint);
    quad([a[0], a[1] - w, a[2]], [a[0], a[1] + w, a[2]], [b[0], b[1] + w, b[2]], [b[0], b[1] - w, b[2]], paint);
    quad([a[0], a[1], a[2] - w], [a[0], a[1], a[2] + w], [b[0], b[1], b[2] + w], [b[0], b[1], b[2] - w], paint);
  }
  // Centre, turn(x, y, z) -> world, half sizes.
  function box(place, half, offset, paint) {
    const p = [];
    for (const sx of [-1, 1])
      for (const sy of [-1, 1])
        for (const sz of [-1, 1])
          p.push(place([offset[0] + sx * half[0], offset[1] + sy * half[1], offset[2] + sz * half[2]]));
    for (const [a, b, c, d, light] of [
      [0, 1, 3, 2, 0.75],
      [4, 6, 7, 5, 0.9],
      [0, 4, 5, 1, 0.8],
      [2, 3, 7, 6, 0.8],
      [1, 5, 7, 3, 1],
      [0, 2, 6, 4, 0.5],
    ])
      quad(p[a], p[b], p[c], p[d], [...paint.slice(0, 3).map((v) => v * light), paint[3]]);
  }
  function disc(x, y, z, radius, paint, inner = 0) {
    for (let k = 0; k < 24; k++) {
      const a = (k * Math.PI) / 12,
        b = ((k + 1) * Math.PI) / 12;
      const ring = (angle, r) => [x + r * Math.cos(angle), y + r * Math.sin(angle), z];
      quad(ring(a, inner), ring(a, radius), ring(b, radius), ring(b, inner), paint);
    }
  }
  return shapes;
}

// A point every tenth of a metre at least.
function dense(xs, ys) {
  const out = [[xs[0], ys[0]]];
  for (let k = 1; k < xs.length; k++) {
    const n = Math.max(1, Math.ceil(Math.hypot(xs[k] - xs[k - 1], ys[k] - ys[k - 1]) / 0.1));
    for (let i = 1; i <= n; i++)
      out.push([xs[k - 1] + ((xs[k] - xs[k - 1]) * i) / n, ys[k - 1] + ((ys[k] - ys[k - 1]) * i) / n]);
  }
  return out;
}

export function rotate([x, y, z, w], [a, b, c]) {
  const tx = 2 * (y * c - z * b),
    ty = 2 * (z * a - x * c),
    tz = 2 * (x * b - y * a);
  return [a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx];
}

const SEGMENTS = [
  [0, 2, 1, 2],
  [1, 2, 1, 1],
  [1, 1, 1, 0],
  [0, 0, 1, 0],
  [0, 1, 0, 0],
  [0, 2, 0, 1],
  [0, 1, 1, 1],
];
const DIGITS = ["012345", "12", "01643", "01623", "5612", "05623", "056234", "012", "0123456", "0123565"];

// Places of a mission in their order: { x, y, yaw, number, paint }. One colour for what is done, one for the present step.
export function places(mission) {
  return mission.steps.flatMap((step, k) =>
    step.x === undefined
      ? []
      : [
          {
            x: step.x,
            y: step.y,
            yaw: step.yaw,
            number: k + 1,
            paint:
              k + 1 === mission.step
                ? COLOUR.goal
                : ["FINISHED", "FAILED"].includes(mission.action_status[k])
                  ? COLOUR.done
                  : COLOUR.step,
          },
        ],
  );
}

// Figures over a place that face the camera.
function figures(shapes, number, x, y, z, { azimuth, elevation }, paint) {
  const right = [-Math.sin(azimuth), Math.cos(azimuth)],
    s = Math.sin(elevation),
    up = [-s * Math.cos(azimuth), -s * Math.sin(azimuth), Math.cos(elevation)],
    digits = [...String(number)];
  digits.forEach((digit, k) => {
    const from = 0.24 * (k - (digits.length - 1) / 2) - 0.07;
    for (const segment of DIGITS[digit]) {
      const [ax, az, bx, bz] = SEGMENTS[segment],
        at = (u, v) => [0, 1, 2].map((i) => [x, y, z][i] + (right[i] ?? 0) * (from + 0.14 * u) + up[i] * 0.14 * v);
      shapes.line3(at(ax, az), at(bx, bz), 0.05, paint);
    }
  });
}

// All of the world but terrain, points and graph.
export function build(world, ground, camera) {
  const shapes = makeShapes();
  const [length, width] = world.body;
  const onGround = (x, y, z) => {
    const h = ground.height(x, y);
    return Number.isNaN(h) ? z : h;
  };
  const { pose } = world;
  const base = pose ? onGround(pose.x, pose.y, pose.z - 0.4) : 0;
  const lay = (points) =>
    dense(
      points.map((p) => p[0]),
      points.map((p) => p[1]),
    ).map(([x, y]) => [x, y, onGround(x, y, base)]);
  for (const { keep_out, corners } of world.fence)
    shapes.ribbon(lay([...corners, corners[0]]), keep_out ? 0.12 : 0.07, keep_out ? COLOUR.worst : COLOUR.allowed);
  if (world.drawn?.points.length) {
    const { mode, points } = world.drawn;
    const ring = points.map(({ x, y }) => [x, y]);
    if (mode === "area" && ring.length > 2) ring.push(ring[0]);
    shapes.ribbon(lay(ring), 0.08, COLOUR.drawn);
    points.forEach(({ x, y, yaw }, k) => {
      const z = onGround(x, y, base);
      shapes.disc(x, y, z + 0.07, 0.14, COLOUR.drawn);
      if (mode === "way") figures(shapes, k + 1, x, y, z + 0.3, camera, COLOUR.drawn);
      if (yaw !== null) arrow(shapes, x, y, z + 0.08, yaw, 0.5, COLOUR.drawn);
    });
  }
  for (const [plan, paint] of [
    [world.route, COLOUR.route],
    [world.preview, COLOUR.preview],
  ]) {
    if (!plan?.ok) continue;
    if (plan.native_x.length)
      shapes.ribbon(
        dense(plan.native_x, plan.native_y).map(([x, y]) => [x, y, onGround(x, y, base)]),
        0.06,
        COLOUR.native,
        { dash: 0.2 },
      );
    shapes.ribbon(
      plan.x.map((x, k) => [x, plan.y[k], onGround(x, plan.y[k], plan.z[k])]),
      0.11,
      paint,
    );
    plan.worst_x.forEach((x, k) => {
      const chosen = world.chosen === k && world.shown === plan,
        worst = k === plan.worst;
      if (!chosen && !worst) return;
      outline(
        shapes,
        x,
        plan.worst_y[k],
        onGround(x, plan.worst_y[k], base),
        plan.worst_yaw[k],
        length,
        width,
        chosen ? COLOUR.chosen : COLOUR.worst,
      );
    });
  }
  if (world.mission) {
    const stops = places(world.mission);
    shapes.ribbon(
      stops.length
        ? dense(
            stops.map((p) => p.x),
            stops.map((p) => p.y),
          ).map(([x, y]) => [x, y, onGround(x, y, base)])
        : [],
      0.05,
      COLOUR.step,
      { dash: 0.15 },
    );
    for (const { x, y, yaw, number, paint } of stops) {
      const z = onGround(x, y, base);
      shapes.disc(x, y, z + 0.06, 0.16, paint);
      figures(shapes, number, x, y, z + 0.3, camera, paint);
      if (yaw !== null && yaw !== undefined) arrow(shapes, x, y, z + 0.07, yaw, 0.5, paint);
    }
  }
  const arc = world.arc ?? [];
  shapes.ribbon(
    arc.map(({ x, y }) => [x, y, onGround(x, y, base)]),
    0.16,
    (k) => risky(arc[k + 1].risk),
    { lift: 0.06 },
  );
  for (const { x, y, yaw, risk } of bodies(arc))
    outline(shapes, x, y, onGround(x, y, base), yaw, length, width, risky(risk), 0.03);
  for (const [goal, alpha] of [
    [world.goal, 255],
    [world.aim, 200],
  ]) {
    if (!goal) continue;
    const z = onGround(goal.x, goal.y, base),
      paint = [...COLOUR.goal.slice(0, 3), alpha];
    shapes.disc(goal.x, goal.y, z + 0.06, 0.3, paint, 0.22);
    shapes.line3([goal.x, goal.y, z], [goal.x, goal.y, z + 0.9], 0.04, paint);
    if (goal.yaw !== null && goal.yaw !== undefined) arrow(shapes, goal.x, goal.y, z + 0.08, goal.yaw, 0.75, paint);
  }
  if (world.mark) {
    const { x, y } = world.mark;
    shapes.disc(x, y, onGround(x, y, base) + 0.08, 0.35, COLOUR.worst, 0.25);
    shapes.line3([x, y, onGround(x, y, base)], [x, y, onGround(x, y, base) + 1.2], 0.05, COLOUR.worst);
  }
  if (world.home) {
    const { x, y, yaw } = world.home,
      z = onGround(x, y, base);
    outline(shapes, x, y, z, yaw, length, width, COLOUR.home, 0.06);
    shapes.line3([x, y, z], [x, y, z + 0.6], 0.05, COLOUR.home);
  }
  for (const { x, y, yaw } of world.candidates ?? [])
    outline(shapes, x, y, onGround(x, y, base), yaw, length, width, COLOUR.preview, 0.08);
  if (world.place)
    outline(
      shapes,
      world.place.x,
      world.place.y,
      onGround(world.place.x, world.place.y, base),
      world.place.yaw,
      length,
      width,
      COLOUR.goal,
      0.08,
    );
  if (pose) {
    const place = (p) => {
      const [a, b, c] = rotate(pose.q, p);
      return [pose.x + a, pose.y + b, pose.z + c];
    };
    shapes.box(
      place,
      [length / 2 - 0.06, 0.12, 0.075],
      [0, 0, 0],
      world.fresh === "stale" ? [150, 150, 150, 255] : COLOUR.robot,
    );
    shapes.box(place, [0.05, 0.08, 0.05], [length / 2 - 0.02, 0, 0.04], COLOUR.route);
    for (const sx of [-1, 1])
      for (const sy of [-1, 1]) {
        shapes.box(place, [0.035, 0.03, 0.14], [sx * 0.22, sy * 0.16, -0.17], COLOUR.dark);
        shapes.box(place, [0.08, 0.035, 0.08], [sx * 0.24, sy * 0.18, -0.3], COLOUR.dark);
      }
    arrow(
      shapes,
      pose.x + 0.45 * Math.cos(pose.yaw),
      pose.y + 0.45 * Math.sin(pose.yaw),
      base + 0.05,
      pose.yaw,
      0.35,
      COLOUR.route,
    );
  }
  return shapes;
}

// Of an arc: where the body is drawn whole.
export const bodies = (arc) => arc.filter((_, k) => k && k % 4 === 0);

// The closed rim of a rectangle that lies on the ground: five places x, y.
export function rim(x, y, yaw, length, width) {
  const c = Math.cos(yaw),
    s = Math.sin(yaw);
  return [
    [1, 1],
    [1, -1],
    [-1, -1],
    [-1, 1],
    [1, 1],
  ].map(([a, b]) => [x + (c * a * length - s * b * width) / 2, y + (s * a * length + c * b * width) / 2]);
}

function outline(shapes, x, y, z, yaw, length, width, paint, thick = 0.05) {
  const c = Math.cos(yaw),
    s = Math.sin(yaw);
  const corners = rim(x, y, yaw, length, width).map(([a, b]) => [a, b, z + 0.07]);
  shapes.ribbon(corners, thick, paint);
  shapes.ribbon(
    [
      [x + c * length * 0.15, y + s * length * 0.15, z + 0.07],
      [x + c * length * 0.5, y + s * length * 0.5, z + 0.07],
    ],
    thick,
    paint,
  );
}
function arrow(shapes, x, y, z, yaw, long, paint) {
  const to = (a, b) => [x + Math.cos(yaw) * a - Math.sin(yaw) * b, y + Math.sin(yaw) * a + Math.cos(yaw) * b, z];
  shapes.ribbon([to(0, 0), to(long, 0)], 0.07, paint, { lift: 0 });
  shapes.ribbon([to(long - 0.18, 0.14), to(long, 0)], 0.07, paint, { lift: 0 });
  shapes.ribbon([to(long - 0.18, -0.14), to(long, 0)], 0.07, paint, { lift: 0 });
}
