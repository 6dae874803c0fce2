// Drawn on the ground: places to drive through, or an area to explore or to cover. Nothing moves before it is sent.
import { $, button, figure, get, post, put } from "./tell.js";

export function makeDraw(link, view, about, free) {
  const { world } = view;
  let mode = "", // "way", "area", or nothing
    areas = [],
    before = []; // fences that were drawn earlier, for undo
  const drawn = () => link.newest.areas?.areas ?? [];
  const least = () => (mode === "area" ? 3 : 1);

  function set(next) {
    mode = next;
    world.drawn = mode ? { mode, points: [] } : null;
    for (const name of ["way", "area"]) $(`draw-${name}`).setAttribute("aria-pressed", mode === name);
    $("draw-said").textContent = "";
    show();
  }
  function show() {
    const points = world.drawn?.points ?? [];
    $("draw-acts").hidden = !mode;
    $("draw-go").hidden = mode !== "way";
    $("draw-explore").hidden = $("draw-cover").hidden = $("area-form").hidden = mode !== "area";
    const hint =
      mode === "area" ? "Tap its corners in their order." : "Tap the places in their order; drag for a heading.";
    const many = `${points.length} ${mode === "area" ? "corner" : "place"}${points.length > 1 ? "s" : ""}`;
    put("draw-hint", mode ? (points.length ? many : hint) : "");
    lock();
    view.show();
  }
  function lock() {
    const few = (world.drawn?.points.length ?? 0) < least();
    $("draw-undo").disabled = $("draw-clear").disabled = !world.drawn?.points.length;
    for (const id of ["draw-go", "draw-explore", "draw-cover", "area-save", "area-out", "area-in"])
      $(id).disabled = few || !free.may();
    for (const made of document.querySelectorAll("#fence button")) made.disabled = !free.may();
    $("fence-undo").disabled ||= !before.length;
  }
  // Whether a press on the ground meant this.
  function pick(x, y, yaw) {
    if (!mode || $("drive").hidden) return false;
    const far = mode === "way" ? outside(x, y) : "";
    world.mark = far ? { x, y } : null;
    put("draw-said", far);
    if (!far) world.drawn.points.push({ x, y, yaw: mode === "way" ? yaw : null });
    show();
    return true;
  }
  function undo() {
    world.drawn?.points.pop();
    show();
  }
  for (const name of ["way", "area"]) $(`draw-${name}`).onclick = () => set(mode === name ? "" : name);
  $("draw-undo").onclick = undo;
  addEventListener("keydown", (event) => {
    if (event.key !== "z" || !(event.ctrlKey || event.metaKey) || event.target.closest?.("input") || !mode) return;
    event.preventDefault();
    undo();
  });
  $("draw-clear").onclick = () => set(mode);
  async function send(content) {
    const answer = await free.tell(content);
    if (!answer.ok) return;
    set("");
    view.chase();
  }
  const corners = () => world.drawn.points.map(({ x, y }) => [x, y]);
  $("draw-go").onclick = () => {
    const goto = ({ x, y, yaw }) => ({ goto: { x, y, yaw_deg: yaw === null ? null : (yaw * 180) / Math.PI } });
    send({ do: "mission", what: "run", mission: { name: "drawn way", steps: world.drawn.points.map(goto) } });
  };
  $("draw-cover").onclick = () => send({ do: "cover", area: corners() });
  $("draw-explore").onclick = () => send({ do: "explore", area: corners() });
  // What counts from now on.
  async function enclose(next, undone = false) {
    const was = drawn();
    const answer = await free.tell({ do: "areas", areas: next });
    put("draw-said", answer.words);
    if (!answer.ok) return;
    if (undone) before.pop();
    else before.push(was);
    $("draw-clear").click();
    fence();
  }
  for (const [id, keep_out] of [
    ["area-out", true],
    ["area-in", false],
  ])
    $(id).onclick = () => {
      const names = drawn().map(({ name }) => name);
      let name = $("area-name").value.trim(),
        k = 1;
      while (!name || names.includes(name)) name = `${keep_out ? "no-go" : "inside"} ${k++}`;
      enclose([...drawn(), { name, keep_out, corners: corners() }]);
    };
  $("fence-undo").onclick = () => enclose(before.at(-1), true);
  function fence() {
    world.fence = [
      ...(about.area ? [{ keep_out: false, name: "", corners: about.area }] : []),
      ...Object.entries(about.keepout).map(([name, corners]) => ({ keep_out: true, name, corners })),
      ...drawn(),
    ];
    $("fence").hidden = !drawn().length && !before.length;
    $("fence-list").replaceChildren(
      ...drawn().map(({ name, keep_out }) =>
        button(`Remove ${keep_out ? "no-go" : "inside"}: ${name}`, () =>
          enclose(drawn().filter((other) => other.name !== name)),
        ),
      ),
    );
    lock();
    view.show();
  }
  link.on("areas", fence);
  $("area-form").onsubmit = async (event) => {
    event.preventDefault();
    const answer = await post(`/areas/${encodeURIComponent($("area-name").value)}`, { corners: corners() }).catch(
      (error) => ({
        words: `Not saved: ${error.message}`,
      }),
    );
    put("draw-said", answer.words);
    await list();
  };
  async function list() {
    areas = await get("/areas").catch(() => []);
    $("area-list").replaceChildren(
      ...areas.map(({ name, corners }) =>
        button(name, () => {
          set("area");
          world.drawn.points = corners.map(([x, y]) => ({ x, y, yaw: null }));
          const [x, y] = [0, 1].map((axis) => corners.reduce((sum, corner) => sum + corner[axis], 0) / corners.length);
          view.look(x, y);
          show();
        }),
      ),
    );
  }
  $("draw").ontoggle = () => {
    if ($("draw").open) list();
    else set("");
  };

  // How far a place is where the robot may not be [m], in words; empty where it may.
  function outside(x, y) {
    for (const { keep_out, name, corners: ring } of world.fence) {
      let inside = false,
        away = Infinity;
      ring.forEach(([bx, by], k) => {
        const [ax, ay] = ring.at(k - 1);
        if (by > y !== ay > y && x < ax + ((y - ay) * (bx - ax)) / (by - ay)) inside = !inside;
        const t = Math.max(
          0,
          Math.min(1, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)),
        );
        away = Math.min(away, Math.hypot(x - ax - t * (bx - ax), y - ay - t * (by - ay)));
      });
      if (inside === keep_out)
        return `${figure(away, 1)} m ${keep_out ? "inside of the keep-out area" : "outside of the allowed area"} ${name}`;
    }
    return "";
  }
  link.on("beat", lock);
  set("");
  fence();
  return { pick };
}
