// The same world from above on a 2D canvas, for browsers without WebGL2 and after a context that does not come back.
import { doubtful, NEVER, UNKNOWN } from "./ground.js";
import { COLOUR } from "./palette.js";
import { bodies, places, rim, risky } from "./shapes.js";

const css = ([r, g, b, a = 255]) => `rgb(${r} ${g} ${b} / ${a / 255})`;

export function makeFlat(canvas, world, ground, camera) {
  const context = canvas.getContext("2d", { alpha: false });
  const pictures = new Map();
  let layer = -1,
    theme = null;
  const scale = () => camera.height / (2 * camera.distance * Math.tan(camera.fov / 2));
  const spot = (x, y) => [
    camera.width / 2 + (x - camera.at[0]) * scale(),
    camera.height / 2 - (y - camera.at[1]) * scale(),
  ];

  function picture(tile) {
    const image = new ImageData(64, 64);
    for (let r = 0; r < 64; r++)
      for (let c = 0; c < 64; c++) {
        const k = 64 * r + c,
          h = tile.height[k],
          at = 4 * (64 * (63 - r) + c);
        if (h === UNKNOWN) continue;
        const t = Math.max(0, Math.min(1, (h / 1000 - ground.low) / (ground.high - ground.low)));
        const next = c < 63 && tile.height[k + 1] !== UNKNOWN ? tile.height[k + 1] : h,
          light = Math.max(COLOUR.shade[0], Math.min(1.1, 1 + (h - next) / 120));
        const [low, middle, high] = COLOUR.ramp,
          half = t < 0.5 ? [low, middle, 2 * t] : [middle, high, 2 * t - 1];
        let paint = half[0].map((v, i) => v + (half[1][i] - v) * half[2]);
        if (world.layer === 1) paint = tile.risk[k] === 255 ? [128, 128, 128] : risky((tile.risk[k] / 200) * 1.2);
        if (world.layer === 2)
          paint = [
            [140, 140, 140],
            [140, 140, 140],
            [184, 184, 115],
            [89, 158, 191],
            [64, 178, 115],
            [224, 140, 64],
          ][tile.trust[k]];
        if (world.layer === 3) {
          const old = Math.min(1, tile.age[k] / 60 + (performance.now() - tile.aged) / 60000);
          paint =
            tile.age[k] === NEVER
              ? [128, 128, 128]
              : old < 0.5
                ? [77 + 254 * old, 184, 219 - 184 * old]
                : [286 - 164 * old, 302 - 236 * old, 199 - 143 * old];
        }
        if (doubtful(tile.trust[k]) && world.layer !== 3 && (r + c) % 6 < 2)
          paint = paint.map((v, i) => (v + COLOUR.doubt[i]) / 2);
        for (let i = 0; i < 3; i++) image.data[at + i] = paint[i] * light;
        image.data[at + 3] = 255;
      }
    const made = document.createElement("canvas");
    made.width = made.height = 64;
    made.getContext("2d").putImageData(image, 0, 0);
    return made;
  }
  function path(points, wide, paint, dash = [], cased = true) {
    context.beginPath();
    points.forEach(([x, y], k) => context[k ? "lineTo" : "moveTo"](...spot(x, y)));
    context.setLineDash(dash);
    for (const [width, colour] of [...(cased ? [[wide + 3, COLOUR.casing]] : []), [wide, paint]]) {
      context.lineWidth = width;
      context.strokeStyle = css(colour);
      context.stroke();
    }
    context.setLineDash([]);
  }
  // A line every metre, while they stand apart.
  function grid() {
    const [ink, share] = COLOUR.grid,
      [w, h] = [camera.width / scale() / 2, camera.height / scale() / 2],
      [x, y] = camera.at;
    if (scale() < 12) return;
    for (let k = Math.ceil(x - w); k <= x + w; k++) path([[k, y - h], [k, y + h]], 1, [...ink, 255 * share], [], false); // prettier-ignore
    for (let k = Math.ceil(y - h); k <= y + h; k++) path([[x - w, k], [x + w, k]], 1, [...ink, 255 * share], [], false); // prettier-ignore
  }
  function body(x, y, yaw, paint, fill) {
    path(rim(x, y, yaw, ...world.body), 3, paint);
    if (fill) {
      context.fillStyle = css(fill);
      context.fill();
    }
    path(
      [
        [x, y],
        [x + Math.cos(yaw) * world.body[0] * 0.7, y + Math.sin(yaw) * world.body[0] * 0.7],
      ],
      3,
      paint,
    );
  }
  function draw() {
    if (world.layer !== layer || world.layer === 3 || theme !== COLOUR.sky) {
      layer = world.layer;
      theme = COLOUR.sky;
      pictures.clear();
    }
    for (const key of ground.dirty) pictures.delete(key);
    ground.dirty.clear();
    const ratio = canvas.width / camera.width;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = css(COLOUR.sky);
    context.fillRect(0, 0, camera.width, camera.height);
    context.imageSmoothingEnabled = false;
    for (const [key, tile] of ground.tiles) {
      if (!pictures.has(key)) pictures.set(key, picture(tile));
      const size = 64 * ground.res,
        [x, y] = spot((tile.col - 0.5) * ground.res, (tile.row - 0.5) * ground.res + size);
      context.drawImage(pictures.get(key), x, y, size * scale() + 0.5, size * scale() + 0.5);
    }
    grid();
    if (world.graph && world.showGraph) {
      const { at } = world.graph;
      for (let k = 0; k < at.length; k += 6)
        path(
          [
            [at[k], at[k + 1]],
            [at[k + 3], at[k + 4]],
          ],
          1,
          [0, 90, 150, 90],
          [],
          false,
        );
    }
    for (const { keep_out, corners } of world.fence) {
      path([...corners, corners[0]], 3, keep_out ? COLOUR.worst : COLOUR.allowed);
      if (!keep_out) continue;
      context.fillStyle = css([...COLOUR.worst.slice(0, 3), 60]);
      context.fill();
    }
    if (world.drawn?.points.length) {
      const { mode, points } = world.drawn;
      const ring = points.map(({ x, y }) => [x, y]);
      if (mode === "area" && ring.length > 2) ring.push(ring[0]);
      path(ring, 3, COLOUR.drawn);
      for (const { x, y, yaw } of points) {
        context.beginPath();
        context.arc(...spot(x, y), 7, 0, 7);
        context.fillStyle = css(COLOUR.drawn);
        context.fill();
        if (yaw !== null) path([[x, y], [x + 0.5 * Math.cos(yaw), y + 0.5 * Math.sin(yaw)]], 4, COLOUR.drawn); // prettier-ignore
      }
    }
    for (const [plan, paint] of [
      [world.route, COLOUR.route],
      [world.preview, COLOUR.preview],
    ]) {
      if (!plan?.ok) continue;
      path(
        plan.native_x.map((x, k) => [x, plan.native_y[k]]),
        2,
        COLOUR.native,
        [8, 8],
      );
      path(
        plan.x.map((x, k) => [x, plan.y[k]]),
        5,
        paint,
      );
      if (plan.worst >= 0)
        body(plan.worst_x[plan.worst], plan.worst_y[plan.worst], plan.worst_yaw[plan.worst], COLOUR.worst);
      if (world.shown === plan && world.chosen !== null && world.chosen !== undefined)
        body(plan.worst_x[world.chosen], plan.worst_y[world.chosen], plan.worst_yaw[world.chosen], COLOUR.chosen);
    }
    if (world.mission) {
      const stops = places(world.mission);
      path(
        stops.map((p) => [p.x, p.y]),
        2,
        COLOUR.step,
        [6, 6],
      );
      context.font = "bold 14px system-ui, sans-serif";
      context.textAlign = "center";
      context.textBaseline = "middle";
      for (const { x, y, yaw, number, paint } of stops) {
        if (yaw !== null && yaw !== undefined)
          path(
            [
              [x, y],
              [x + 0.5 * Math.cos(yaw), y + 0.5 * Math.sin(yaw)],
            ],
            4,
            paint,
          );
        const [px, py] = spot(x, y);
        context.beginPath();
        context.arc(px, py, 11, 0, 7);
        context.fillStyle = css(paint);
        context.fill();
        context.fillStyle = "#fff";
        context.fillText(String(number), px, py);
      }
    }
    const arc = world.arc ?? [];
    for (let k = 0; k + 1 < arc.length; k++)
      path(
        [arc[k], arc[k + 1]].map(({ x, y }) => [x, y]),
        7,
        risky(arc[k + 1].risk),
      );
    for (const { x, y, yaw, risk } of bodies(arc)) body(x, y, yaw, risky(risk));
    for (const goal of [world.goal, world.aim])
      if (goal) {
        const [x, y] = spot(goal.x, goal.y);
        context.beginPath();
        context.arc(x, y, 10, 0, 7);
        context.lineWidth = 4;
        context.strokeStyle = css(COLOUR.goal);
        context.stroke();
        if (goal.yaw !== null && goal.yaw !== undefined)
          path(
            [
              [goal.x, goal.y],
              [goal.x + 0.75 * Math.cos(goal.yaw), goal.y + 0.75 * Math.sin(goal.yaw)],
            ],
            4,
            COLOUR.goal,
          );
      }
    if (world.mark) {
      context.beginPath();
      context.arc(...spot(world.mark.x, world.mark.y), 12, 0, 7);
      context.lineWidth = 4;
      context.strokeStyle = css(COLOUR.worst);
      context.stroke();
    }
    if (world.home) body(world.home.x, world.home.y, world.home.yaw, COLOUR.home);
    for (const { x, y, yaw } of world.candidates ?? []) body(x, y, yaw, COLOUR.preview);
    if (world.place) body(world.place.x, world.place.y, world.place.yaw, COLOUR.goal);
    if (world.pose)
      body(
        world.pose.x,
        world.pose.y,
        world.pose.yaw,
        COLOUR.dark,
        world.fresh === "stale" ? [150, 150, 150] : COLOUR.robot,
      );
    return false;
  }
  return {
    kind: "2D",
    draw,
    begin() {
      pictures.clear();
    },
    place: (px, py) => {
      const x = camera.at[0] + (px - camera.width / 2) / scale(),
        y = camera.at[1] - (py - camera.height / 2) / scale(),
        z = ground.height(x, y);
      return [x, y, Number.isNaN(z) ? 0 : z];
    },
  };
}
