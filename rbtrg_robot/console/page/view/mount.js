// mount(element, options) -> view: the terrain with everything on it. `options.pick(x, y, yaw)` is called for a goal, `options.said(words)`
// when the picture changes its kind. `view.world` is what is drawn; call `view.show()` after changing it.
import { makeCamera, steer } from "./camera.js";
import { makeFlat } from "./flat.js";
import { makeGl } from "./gl.js";
import { makeGround } from "./ground.js";

const RESTORE = 3000; // milliseconds a lost context has to come back

export function mount(element, options) {
  const ground = makeGround(),
    camera = makeCamera();
  const world = {
    pose: null,
    route: null,
    preview: null,
    goal: null,
    home: null,
    aim: null,
    mission: null,
    place: null,
    candidates: null,
    arc: null,
    mark: null,
    fence: [], // { keep_out, corners [x, y] }: what the robot stays in and keeps out of
    drawn: null, // { mode, points } on the way to be sent
    cloud: null,
    graph: null,
    chosen: null,
    shown: null,
    layer: 0,
    points: true,
    showGraph: false,
    fresh: "stale",
    body: [0.7, 0.43],
  };
  const view = {
    ground,
    camera,
    world,
    show,
    kind: "",
    moving: false,
    follow: true,
    frames: 0,
    above,
    look,
    chase,
    place: (x, y) => painter?.place(x, y),
  };
  let canvas,
    painter,
    asked = false,
    handles;

  function fresh() {
    canvas?.remove();
    canvas = document.createElement("canvas");
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute(
      "aria-label",
      "Terrain around the robot. Everything on it is also in the forms and tables beside it. Arrow keys turn the view, plus and minus zoom.",
    );
    element.append(canvas);
    handles = steer(canvas, camera, {
      moving: () => view.moving,
      changed: show,
      moved: () => {
        if (view.follow) {
          view.follow = false;
          options.followed?.(false);
        }
      },
      place: (x, y) => painter.place(x, y),
      aim: (at, yaw) => {
        world.aim = at ? { x: at[0], y: at[1], yaw } : null;
        show();
      },
      grab: (at) => options.grab?.(...at),
      pick: (at, yaw) => options.pick(at[0], at[1], yaw),
    });
    canvas.addEventListener("keydown", (event) => {
      const go = { ArrowLeft: [0.15, 0], ArrowRight: [-0.15, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
      if (go) {
        event.preventDefault();
        handles.turn(...go);
      }
      if (event.key === "+" || event.key === "-") handles.zoom(event.key === "+" ? 0.85 : 1.18);
    });
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      options.said("The picture was lost; it is being made again.");
      setTimeout(() => {
        if (painter.kind === "3D" && canvas.getContext("webgl2").isContextLost()) {
          fresh();
          use(makeFlat);
          options.said("3D is gone; the ground is shown from above.");
        }
      }, RESTORE);
    });
    canvas.addEventListener("webglcontextrestored", () => {
      painter.begin();
      options.said("");
      show();
    });
    watch.disconnect();
    watch.observe(element);
    size();
  }
  function use(make) {
    painter = make(canvas, world, ground, camera);
    view.kind = painter?.kind ?? "";
    show();
    return painter;
  }
  function size() {
    const ratio = Math.min(2, window.devicePixelRatio || 1),
      box = element.getBoundingClientRect();
    camera.width = Math.max(1, box.width);
    camera.height = Math.max(1, box.height);
    canvas.width = Math.round(camera.width * ratio);
    canvas.height = Math.round(camera.height * ratio);
    show();
  }
  // Once for however much changed since the last frame.
  function show() {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      if (!painter) return;
      if (view.follow && world.pose) camera.at = [world.pose.x, world.pose.y, world.pose.z - 0.3];
      view.frames++;
      if (painter.draw()) show();
      view.drawn?.();
    });
  }
  function above() {
    camera.top = !camera.top;
    camera.elevation = camera.top ? 1.55 : 0.75;
    if (camera.top) camera.azimuth = -Math.PI / 2;
    show();
    return camera.top;
  }

  // What was just sent off is what matters: the picture goes with the robot again.
  function chase() {
    view.follow = true;
    options.followed?.(true);
    show();
  }

  // Turn the picture to a place on the ground.
  function look(x, y) {
    const z = ground.height(x, y);
    camera.at = [x, y, Number.isNaN(z) ? camera.at[2] : z];
    view.follow = false;
    options.followed?.(false);
    show();
  }

  const watch = new ResizeObserver(size);
  fresh();
  if (options.flat || !use(makeGl)) {
    if (!options.flat) fresh();
    use(makeFlat);
    options.said("This browser has no WebGL2: the ground is shown from above.");
  }
  return view;
}
