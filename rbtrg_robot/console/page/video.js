// The camera: the newest picture with the route and the footprint drawn into it, and how old it is.
import { $, put } from "./tell.js";

const OLD = 1000; // milliseconds: grey
const PING = 2000; // milliseconds between two measures of the link
const MODES = ["off", "beside", "behind"];
const NAMES = { off: "Camera", beside: "Camera: beside", behind: "Camera: full" };
const NEAR = 0.05; // metres before the lens
const STRIDE = 0.4; // metres between two outlines of the body on the way
const text = new TextDecoder();

export function makeVideo(link, about, free, see) {
  const canvas = $("video-picture"),
    pen = canvas.getContext("2d");
  let mode = 0,
    shown = null, // what was drawn last: facts, when it came and was painted
    delay = 0; // of the link, one way [ms]

  function set(next) {
    mode = next;
    const name = MODES[mode];
    document.body.dataset.video = name;
    $("video").hidden = name === "off";
    put("video-mode", NAMES[name]);
    $("video-mode").setAttribute("aria-pressed", name !== "off");
    put("video-said", "no picture yet");
    $("photo").hidden = true;
    shown = null;
    see();
  }
  $("video-mode").hidden = !about.camera;
  $("video-mode").onclick = () => set((mode + 1) % MODES.length);
  addEventListener("keydown", (event) => {
    const typing = event.target.closest?.("input, select, textarea");
    if (event.key !== "v" || typing || event.ctrlKey || event.metaKey || event.altKey || !about.camera) return;
    set((mode + 1) % MODES.length);
  });

  link.on("picture", async (data) => {
    if (MODES[mode] === "off") return;
    const came = performance.now();
    const length = new DataView(data).getUint32(4, true);
    const facts = JSON.parse(text.decode(new Uint8Array(data, 8, length)));
    const jpeg = new Blob([new Uint8Array(data, 8 + length)], { type: "image/jpeg" });
    let image;
    try {
      image = await createImageBitmap(jpeg);
    } catch {
      put("video-said", "the camera sent what is no picture");
      return;
    }
    if (shown && facts.stamp < shown.facts.stamp) return image.close();
    canvas.width = image.width;
    canvas.height = image.height;
    pen.drawImage(image, 0, 0);
    image.close();
    if (facts.fx) draw(facts);
    shown = { facts, came, painted: performance.now(), jpeg };
    $("photo").hidden = false;
    tell();
  });

  // The picture as the camera sent it, of a robot or of a replay.
  $("photo").onclick = () => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(shown.jpeg);
    link.download = `${about.robot}-${shown.facts.stamp.toFixed(3)}.jpg`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    if (free.may()) free.tell({ do: "photo" }); // and the next frame in the log
  };

  // From `map` [m] to pixels, through the pose of the robot; null behind the lens.
  function lens(facts, pose) {
    const [qx, qy, qz, qw] = pose.q;
    const { place, axes } = about.camera;
    const scale = canvas.width / facts.width;
    return ([x, y, z]) => {
      const d = [x - pose.x, y - pose.y, z - pose.z];
      // The inverse of the robot's turn, by its quaternion.
      const t = [2 * (qz * d[1] - qy * d[2]), 2 * (qx * d[2] - qz * d[0]), 2 * (qy * d[0] - qx * d[1])];
      const b = [
        d[0] + qw * t[0] - (qy * t[2] - qz * t[1]) - place[0],
        d[1] + qw * t[1] - (qz * t[0] - qx * t[2]) - place[1],
        d[2] + qw * t[2] - (qx * t[1] - qy * t[0]) - place[2],
      ];
      const [right, down, ahead] = axes.map((axis) => axis[0] * b[0] + axis[1] * b[1] + axis[2] * b[2]);
      if (ahead < NEAR) return null;
      return [scale * (facts.cx + (facts.fx * right) / ahead), scale * (facts.cy + (facts.fy * down) / ahead)];
    };
  }

  function line(points, closed = false) {
    pen.beginPath();
    let on = false;
    for (const point of closed ? [...points, points[0]] : points) {
      if (point) on ? pen.lineTo(...point) : pen.moveTo(...point);
      on = !!point;
    }
    pen.stroke();
  }

  function draw(facts) {
    const { pose, route } = link.newest;
    if (!pose || !route?.ok || !route.x?.length) return;
    const project = lens(facts, pose);
    const at = (k) => [route.x[k], route.y[k], route.z[k]];
    pen.strokeStyle = "#0085e0";
    pen.lineWidth = Math.max(2, canvas.width / 160);
    line(route.x.map((_, k) => project(at(k))));
    pen.lineWidth = Math.max(1, canvas.width / 320);
    let last = null;
    for (let k = 0; k < route.x.length; k++) {
      const away = Math.hypot(route.x[k] - pose.x, route.y[k] - pose.y);
      if (away > 4 || (last !== null && Math.hypot(route.x[k] - route.x[last], route.y[k] - route.y[last]) < STRIDE))
        continue;
      last = k;
      const [c, s] = [Math.cos(route.yaw[k]), Math.sin(route.yaw[k])];
      const [u, v] = about.body.map((side) => side / 2);
      const corner = (a, b) => project([route.x[k] + a * c - b * s, route.y[k] + a * s + b * c, route.z[k]]);
      line([corner(u, v), corner(u, -v), corner(-u, -v), corner(-u, v)], true);
    }
  }

  function tell() {
    if (!shown || MODES[mode] === "off") return;
    const { facts, came, painted } = shown;
    const paint = 1000 * facts.age + delay + painted - came; // from the exposure to the paint
    const old = paint + performance.now() - painted;
    $("video").classList.toggle("old", old > OLD);
    put("video-said", `${old.toFixed(0)} ms old; delay ${paint.toFixed(0)} ms, of it ${delay.toFixed(0)} ms the link`);
  }
  setInterval(tell, 100);
  setInterval(async () => {
    if (MODES[mode] === "off" || !link.connected()) return;
    const sent = performance.now();
    try {
      await link.wish({ do: "ping" });
      delay = (performance.now() - sent) / 2;
    } catch {} // the link is told elsewhere
  }, PING);
  return { shows: () => MODES[mode] !== "off" };
}
