// Maps on the robot's disk: save, load; and where the robot stands on one.
import { $, anchor, button, degrees, figure, get, number, post, put, table, twice } from "./tell.js";

export function makeMaps(link, view, free) {
  const { world } = view;
  let loads = [];

  async function maps() {
    const found = await get("/maps");
    loads = [];
    table(
      $("map-list"),
      ["map", "MB", ["", "text"]],
      found.map((map) => {
        const act = document.createElement("span"),
          load = button("Load", null);
        twice(
          load,
          () => "What was mapped is dropped. Really load it?",
          async () => {
            put("map-said", `Loading ${map.name}…`);
            put(
              "map-said",
              (await link.wish({ do: "load map", file: map.name }).catch((error) => ({ words: error.message }))).words,
            );
          },
        );
        loads.push(load);
        act.className = "row";
        act.append(load, anchor("Download", `/maps/${map.name}`));
        return [map.name, figure(map.megabytes), act];
      }),
    );
    lock();
  }
  $("save-map").onsubmit = async (event) => {
    event.preventDefault();
    put("map-said", "Saving…");
    try {
      put("map-said", (await post(`/maps/${encodeURIComponent($("map-name").value)}`)).words);
      await maps();
    } catch (error) {
      put("map-said", `Not saved: ${error.message}`);
    }
  };

  // --- where it stands --------------------------------------------------------------------------------------
  function wanted() {
    const [x, y, yaw] = ["px", "py", "pyaw"].map(number);
    return [x, y, yaw].some((v) => v === null || !Number.isFinite(v)) ? null : { x, y, yaw: (yaw * Math.PI) / 180 };
  }
  function fill({ x, y, yaw }) {
    $("px").value = figure(x);
    $("py").value = figure(y);
    if (yaw !== null) $("pyaw").value = figure(degrees(yaw), 0);
    world.place = wanted();
    view.show();
  }
  // What the search in the map says; where several places look alike, each of them is a button.
  let asked = "";
  link.on("map", (map) => {
    put("location", map.location_detail);
    const found = [];
    for (let k = 0; k + 2 < map.candidates.length; k += 3) {
      const [x, y, yaw] = map.candidates.slice(k, k + 3);
      found.push({ x, y, yaw });
    }
    if (JSON.stringify(found) === asked) return;
    asked = JSON.stringify(found);
    world.candidates = found;
    $("candidates").replaceChildren(
      ...found.map((at) =>
        button(`${figure(at.x)} ${figure(at.y)}, ${figure(degrees(at.yaw), 0)} deg`, () => {
          fill(at);
          put("place-said", "If it stands there, say so below.");
        }),
      ),
    );
    view.show();
  });
  function mode(on) {
    $("place-mode").setAttribute("aria-pressed", on);
    if (!on) {
      world.place = null;
      view.show();
    }
  }
  $("place-mode").onclick = () => mode($("place-mode").getAttribute("aria-pressed") !== "true");
  for (const id of ["px", "py", "pyaw"])
    $(id).oninput = () => {
      world.place = wanted();
      view.show();
    };
  // Whether a press on the ground meant this.
  function pick(x, y, yaw) {
    if ($("maps").hidden || $("place-mode").getAttribute("aria-pressed") !== "true") return false;
    fill({ x, y, yaw });
    if (yaw === null) put("place-said", "Drag the way it looks, or type its heading.");
    return true;
  }
  $("place").onsubmit = async (event) => {
    event.preventDefault();
    const pose = wanted();
    if (!pose) return put("place-said", "A pose is x and y in metres and a heading.");
    put("place-said", "…");
    const answer = await link.wish({ do: "set pose", ...pose }).catch((error) => ({ ok: false, words: error.message }));
    put("place-said", answer.words);
    if (answer.ok) mode(false);
  };

  function lock() {
    const locked = link.fresh === "stale" || !free.operating();
    for (const made of [...loads, $("place-set"), $("save-map").querySelector("button")]) made.disabled = locked;
  }
  const say = (error) => free.say(error.message, "bad");
  return { lock, pick, show: () => maps().catch(say) };
}
