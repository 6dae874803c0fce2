// How large things are, where x and y of the map point, and where the cursor is, in metres.
import { $, figure, put } from "./tell.js";

const STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50]; // metres
const LONGEST = 90; // pixels

export function makeMeasure(view) {
  const pen = $("compass").getContext("2d");
  const bar = $("scale").firstChild,
    label = $("scale").lastChild;
  let before = "",
    spot = null;

  // Where an axis of the map points on the screen, right and down.
  function axis(dx, dy) {
    const { camera, kind } = view;
    if (kind === "2D") return [dx, -dy];
    const [x, y, z] = camera.at;
    const [from, to] = [camera.project([x, y, z]), camera.project([x + 0.1 * dx, y + 0.1 * dy, z])];
    if (!from || !to) return [0, 0];
    const n = Math.hypot(to[0] - from[0], to[1] - from[1]) || 1;
    return [(to[0] - from[0]) / n, (to[1] - from[1]) / n];
  }
  view.drawn = () => {
    const { camera } = view;
    const metre = camera.height / (2 * camera.distance * Math.tan(camera.fov / 2));
    const now = [metre, camera.azimuth, camera.elevation, view.kind].join();
    if (now === before) return;
    before = now;
    const long = STEPS.findLast((step) => step * metre <= LONGEST) ?? STEPS[0];
    bar.style.width = `${long * metre}px`;
    label.textContent = `${long} m`;
    pen.clearRect(0, 0, 88, 88);
    pen.strokeStyle = pen.fillStyle = getComputedStyle(document.body).color;
    pen.lineWidth = 3;
    pen.font = "bold 22px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    for (const [name, dx, dy] of [
      ["x", 1, 0],
      ["y", 0, 1],
    ]) {
      const [a, b] = axis(dx, dy);
      pen.beginPath();
      pen.moveTo(44, 44);
      pen.lineTo(44 + 22 * a, 44 + 22 * b);
      pen.stroke();
      pen.fillText(name, 44 + 34 * a, 44 + 34 * b);
    }
  };

  function tell() {
    if (!spot) return put("under", "");
    const box = $("view").getBoundingClientRect(),
      at = view.place(spot[0] - box.left, spot[1] - box.top);
    put("under", at ? `x ${figure(at[0])} y ${figure(at[1])} z ${figure(at[2])} m` : "");
  }
  $("view").addEventListener("pointermove", (event) => {
    if (event.pointerType === "touch") return;
    if (!spot) requestAnimationFrame(() => (tell(), (spot = null)));
    spot = [event.clientX, event.clientY];
  });
  $("view").addEventListener("pointerleave", () => put("under", ""));
}
