// Where one looks from, and what fingers and mouse do to it.

export function makeCamera() {
  const camera = {
    at: [0, 0, 0],
    azimuth: -2.2,
    elevation: 0.75,
    distance: 9,
    fov: 0.8,
    width: 1,
    height: 1,
    eye,
    matrix,
    ray,
    project,
    top: false,
  };

  function eye() {
    const { at, azimuth, distance } = camera,
      up = Math.min(1.55, camera.elevation),
      c = Math.cos(up);
    return [
      at[0] + distance * c * Math.cos(azimuth),
      at[1] + distance * c * Math.sin(azimuth),
      at[2] + distance * Math.sin(up),
    ];
  }
  function axes() {
    const e = eye(),
      f = unit([camera.at[0] - e[0], camera.at[1] - e[1], camera.at[2] - e[2]]);
    const r = unit(cross(f, [0, 0, 1])),
      u = cross(r, f);
    return { e, f, r, u };
  }
  function matrix() {
    const { e, f, r, u } = axes(),
      near = 0.1,
      far = 200,
      t = 1 / Math.tan(camera.fov / 2),
      aspect = camera.width / camera.height;
    const view = [
      r[0],
      u[0],
      -f[0],
      0,
      r[1],
      u[1],
      -f[1],
      0,
      r[2],
      u[2],
      -f[2],
      0,
      -dot(r, e),
      -dot(u, e),
      dot(f, e),
      1,
    ];
    const lens = [
      t / aspect,
      0,
      0,
      0,
      0,
      t,
      0,
      0,
      0,
      0,
      (far + near) / (near - far),
      -1,
      0,
      0,
      (2 * far * near) / (near - far),
      0,
    ];
    return multiply(lens, view);
  }
  // x, y in pixels of the picture.
  function ray(x, y) {
    const { e, f, r, u } = axes(),
      t = Math.tan(camera.fov / 2);
    const a = (((2 * x) / camera.width - 1) * t * camera.width) / camera.height,
      b = (1 - (2 * y) / camera.height) * t;
    return [e, unit([f[0] + a * r[0] + b * u[0], f[1] + a * r[1] + b * u[1], f[2] + a * r[2] + b * u[2]])];
  }
  function project([x, y, z]) {
    const m = matrix(),
      w = m[3] * x + m[7] * y + m[11] * z + m[15];
    if (w <= 0) return null;
    return [
      (0.5 + (m[0] * x + m[4] * y + m[8] * z + m[12]) / w / 2) * camera.width,
      (0.5 - (m[1] * x + m[5] * y + m[9] * z + m[13]) / w / 2) * camera.height,
    ];
  }
  return camera;
}

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => {
  const n = Math.hypot(...a) || 1;
  return [a[0] / n, a[1] / n, a[2] / n];
};
export function multiply(a, b) {
  const out = new Array(16).fill(0);
  for (let i = 0; i < 4; i++)
    for (let j = 0; j < 4; j++) for (let k = 0; k < 4; k++) out[4 * j + i] += a[4 * k + i] * b[4 * j + k];
  return out;
}

// One finger or the left button: a goal (tap) with a heading (press and drag), or the view where `moving()`. What `grab(at)` gives for
// the ground that is pressed goes with the finger: it is called with each place, and with whether it is let go there.
// Two fingers, the right button or shift: orbit, pan, pinch. Wheel: nearer, farther.
export function steer(element, camera, { moving, changed, moved, place, aim, grab, pick }) {
  const down = new Map();
  let start = null,
    gesture = null,
    corner = null;
  // Pixels of the picture. Where it stood when the first finger came down counts until the last one is gone: a warning that
  // comes meanwhile may move the picture, and must not turn the heading that a finger draws.
  const spot = (event) => [event.clientX - corner.left, event.clientY - corner.top];

  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("pointerdown", (event) => {
    element.setPointerCapture(event.pointerId);
    if (!down.size) corner = element.getBoundingClientRect();
    down.set(event.pointerId, spot(event));
    if (down.size === 2) {
      start?.held?.(null, true);
      start = null;
      aim(null);
      gesture = spread();
      return;
    }
    const ground = place(...spot(event)),
      orbit = event.button === 2 || event.button === 1 || event.shiftKey || moving();
    start = {
      at: spot(event),
      ground,
      orbit,
      held: (!orbit && ground && grab(ground)) || null,
      pan: event.shiftKey || event.button === 1,
      far: false,
    };
  });
  element.addEventListener("pointermove", (event) => {
    if (!down.has(event.pointerId)) return;
    const before = down.get(event.pointerId),
      now = spot(event);
    down.set(event.pointerId, now);
    if (down.size === 2 && gesture) {
      const next = spread();
      zoom(gesture.size / next.size);
      turn(gesture.angle - next.angle, 0);
      pan(next.x - gesture.x, next.y - gesture.y);
      gesture = next;
      return;
    }
    if (!start) return;
    start.far ||= Math.hypot(now[0] - start.at[0], now[1] - start.at[1]) > 8;
    if (!start.far) return;
    if (start.orbit) {
      if (start.pan || camera.top) pan(now[0] - before[0], now[1] - before[1]);
      else turn(-(now[0] - before[0]) * 0.006, (now[1] - before[1]) * 0.006);
    } else if (start.ground) {
      const to = place(...now);
      if (to && start.held) start.held(to, false);
      else if (to) aim(start.ground, heading(start.ground, to));
    }
  });
  const up = (event) => {
    if (!down.delete(event.pointerId)) return;
    gesture = null;
    if (!start || event.type === "pointercancel") {
      start?.held?.(null, true);
      start = null;
      return aim(null);
    }
    const { ground, orbit, far, held } = start,
      to = far ? place(...spot(event)) : null;
    start = null;
    aim(null);
    if (held) return held(to, true);
    if (!orbit && ground)
      pick(ground, to && Math.hypot(to[0] - ground[0], to[1] - ground[1]) > 0.05 ? heading(ground, to) : null);
  };
  element.addEventListener("pointerup", up);
  element.addEventListener("pointercancel", up);
  element.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      zoom(Math.exp(event.deltaY * 0.0012));
    },
    { passive: false },
  );

  const heading = (a, b) => Math.atan2(b[1] - a[1], b[0] - a[0]);
  function spread() {
    const [a, b] = [...down.values()];
    return {
      x: (a[0] + b[0]) / 2,
      y: (a[1] + b[1]) / 2,
      size: Math.max(10, Math.hypot(a[0] - b[0], a[1] - b[1])),
      angle: Math.atan2(b[1] - a[1], b[0] - a[0]),
    };
  }
  function turn(by, up) {
    camera.azimuth += by;
    if (!camera.top) camera.elevation = Math.max(0.12, Math.min(1.5, camera.elevation + up));
    changed();
  }
  function zoom(by) {
    camera.distance = Math.max(1.5, Math.min(60, camera.distance * by));
    changed();
  }
  function pan(dx, dy) {
    const scale = (2 * camera.distance * Math.tan(camera.fov / 2)) / camera.height,
      a = camera.azimuth,
      lean = Math.max(0.35, Math.sin(camera.elevation));
    camera.at[0] += scale * (dx * Math.sin(a) - (dy / lean) * Math.cos(a));
    camera.at[1] += scale * (-dx * Math.cos(a) - (dy / lean) * Math.sin(a));
    moved();
    changed();
  }
  return { turn, zoom, pan };
}
