// The tools over the picture, what the colours mean, and what comes for it.
import { $, figure, put } from "./tell.js";
import { makeVideo } from "./video.js";
import { COLOUR, wear } from "./view/palette.js";

const TRUST = 2,
  AGE = 3;
const NOTES = {
  [TRUST]: "yellow: bridged between rays; orange: assumed, nobody saw it; empty: not seen; hatched: not trusted",
  [AGE]: "grey: not known when",
};

export function makePicture(link, view, about, free) {
  const small = matchMedia("(max-width: 860px)").matches;
  let ready = false;
  const video = makeVideo(link, about, free, see);

  function hint(words) {
    put(
      "hint",
      words ||
        (view.moving
          ? "Drag to turn the view; two fingers move and zoom."
          : link.replay
            ? "A replay takes no goals."
            : small
              ? "Tap the ground for a goal; drag for its heading."
              : "Tap the ground for a goal; press and drag for its heading. Right button or two fingers: the view."),
    );
  }
  function press(id, on, act) {
    const made = $(id);
    made.onclick = () => {
      const now = made.getAttribute("aria-pressed") !== "true";
      made.setAttribute("aria-pressed", now);
      act(now);
      view.show();
    };
    made.setAttribute("aria-pressed", on);
    act(on);
  }
  press("mode", false, (on) => {
    view.moving = on;
    hint();
  });
  press("follow", true, (on) => {
    view.follow = on;
  });
  press("points", !small, (on) => {
    view.world.points = on;
    see();
  });
  press("graph", false, (on) => {
    view.world.showGraph = on;
    if (on) askGraph();
  });
  $("top").onclick = () => put("top", view.above() ? "From the side" : "From above");
  const LAYERS = [
    ["low", "high", null],
    ["flat", "limit", ["#4c998c", "#e5cc66", "#9e1a38"]],
    ["not trusted", "wheels", ["#8c8c8c", "#599ebf", "#40b373"]],
    ["now", "1 min", ["#4db8db", "#ccb880", "#7a4238"]],
  ];
  function legend() {
    const [from, to, colours] = LAYERS[view.world.layer],
      bar = document.createElement("canvas"),
      paint = bar.getContext("2d");
    bar.width = 110;
    bar.height = 12;
    const shade = paint.createLinearGradient(0, 0, 110, 0);
    (colours ?? COLOUR.ramp.map((rgb) => `rgb(${rgb})`)).forEach((colour, k) => shade.addColorStop(k / 2, colour));
    paint.fillStyle = shade;
    paint.fillRect(0, 0, 110, 12);
    const { low, high } = view.ground;
    const words = [view.world.layer ? from : `${figure(low, 1)} m`, view.world.layer ? to : `${figure(high, 1)} m`];
    const note = small ? "" : (NOTES[view.world.layer] ?? "hatched: not trusted or assumed");
    const [before, after, last] = [...words, note].map((text) => {
      const made = document.createElement("span");
      made.textContent = text;
      return made;
    });
    $("legend").replaceChildren(before, bar, after, ...(note ? [last] : []));
  }
  $("layer").onchange = () => {
    view.world.layer = Number($("layer").value);
    legend();
    see();
    view.show();
  };
  async function askGraph() {
    const { pose } = view.world;
    if (!pose) return;
    const { found } = await link.wish({ do: "ask", x: pose.x, y: pose.y, graph: true }).catch(() => ({}));
    if (!found?.graph_x?.length) return;
    const at = new Float32Array(found.graph_from.length * 6),
      colour = new Uint8Array(found.graph_from.length * 8);
    found.graph_from.forEach((from, k) =>
      [from, found.graph_to[k]].forEach((node, end) => {
        at.set([found.graph_x[node], found.graph_y[node], found.graph_z[node] + 0.04], 6 * k + 3 * end);
        colour.set([20 + 200 * Math.min(1, found.graph_risk[k]), 90, 150, 150], 8 * k + 4 * end);
      }),
    );
    view.world.graph = { at, colour };
    view.show();
  }
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const sky = () => {
    wear(dark.matches ? "dark" : "light");
    legend();
    view.show();
  };
  dark.onchange = sky;
  sky();

  // --- what comes ---------------------------------------------------------------------------------------------
  link.on("pose", (pose) => {
    const before = view.world.pose;
    view.world.pose = pose;
    // A robot that stands is not drawn ten times a second.
    if (
      !before ||
      [..."xyz"].some((axis) => Math.abs(pose[axis] - before[axis]) > 0.002) ||
      pose.q.some((v, k) => Math.abs(v - before.q[k]) > 0.002)
    )
      view.show();
    else view.world.pose = before;
  });
  link.on("terrain", (data) => {
    view.ground.take(data);
    legend();
    view.show();
  });
  link.on("ages", (data) => {
    view.ground.takeAges(data);
    view.show();
  });
  link.on("points", (data) => {
    const head = new Float32Array(data, 4, 7);
    view.world.cloud = { place: head.slice(0, 3), turn: head.slice(3, 7), points: new Int16Array(data, 32) };
    view.show();
  });
  // What the page wants to see of what is large.
  function see() {
    if (ready)
      link.quick({ do: "see", cloud: view.world.points, ages: view.world.layer === AGE, video: video.shows() });
  }
  function clear() {
    view.ground.tiles.clear();
    view.ground.dirty.add("all");
  }
  link.on("open", () => {
    clear();
    see();
  });
  return {
    clear,
    hint,
    // From now on: before, not everything that hears was there.
    begin() {
      ready = true;
      see();
    },
  };
}
