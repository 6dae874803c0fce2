// How the stack is, from the supervisor's own status.
import { $, anchor, figure, get, list, put, table } from "./tell.js";

export function makeHealth(link, about) {
  function show() {
    if ($("health").hidden) return;
    const { status, odometry, map, robot } = link.newest;
    if (status?.processes) {
      put("line-robot", status.lines[0]);
      put("line-goal", status.lines[1]);
      table(
        $("processes"),
        ["process", ["state", "text"], "restarts", "CPU %", "MB", "beat s"],
        status.processes.map((p) => [
          p.process,
          [p.state === "ready" ? "ready" : p.state, p.state === "ready" ? "text word-good" : "text word-bad"],
          String(p.restarts),
          figure(p.cpu, 0),
          figure(p.memory_mb, 0),
          figure(p.heartbeat_age, 1),
        ]),
      );
      table(
        $("topics"),
        ["topic", "Hz", "nominal", "age s", ["", "text"]],
        status.topics
          .filter((x) => x.nominal)
          .map((x) => [
            [x.topic, "wrap"],
            figure(x.rate, 1),
            figure(x.nominal, 0),
            x.age === null ? "–" : figure(x.age),
            x.ok === null ? ["–", "text"] : x.ok ? ["ok", "text word-good"] : ["bad", "text word-bad"],
          ]),
      );
    }
    const rows = [];
    if (odometry)
      rows.push(
        [
          "Odometry",
          odometry.health + (odometry.reason ? `: ${odometry.reason}` : ""),
          odometry.health === "good" ? "word-good" : "word-bad",
        ],
        ["Overlap, inliers", `${figure(odometry.overlap)}, ${figure(odometry.inliers)}`],
        ["Residual", `${figure(1000 * odometry.residual, 0)} mm`],
      );
    if (map)
      rows.push(
        [
          "Map",
          `${map.known_cells} known cells, ${map.trusted_cells} trusted, ${figure(100 * map.resolution, 0)} cm each`,
        ],
        ["Map says", map.warning || map.detail || "all is well"],
      );
    if (robot)
      rows.push(
        ["Battery", robot.battery === null ? "unknown" : `${figure(100 * robot.battery, 0)} %`],
        ["Warmest motor", robot.motor_temperature ? `${figure(robot.motor_temperature, 0)} °C` : "unknown"],
        ["Wheels on the ground", robot.contact.map((on, k) => (on ? ["FR", "FL", "RR", "RL"][k] : "–")).join(" ")],
        ["Real-time factor", figure(robot.realtime_factor)],
      );
    for (const [name, remedy] of Object.entries(status?.robot?.advice ?? {}))
      rows.push(["What to do", `${remedy} (${name})`, "word-bad"]);
    for (const [name, value] of Object.entries(status?.robot?.backend ?? {})) rows.push([name, value]);
    list($("odometry"), rows);
  }
  async function others() {
    if ($("health").hidden || document.hidden) return;
    const found = await get("/robots");
    $("robots-card").hidden = found.length < 2;
    table(
      $("robots"),
      [["robot", "text"], "ready", ["", "text"], ["", "text"]],
      found.map(({ name, ready, processes, lines, console: page }) => {
        const way = anchor("Its console", `/robots/${name}`);
        way.removeAttribute("download");
        way.target = "_blank";
        return [
          [name, "text"],
          `${ready}/${processes}`,
          [lines.join("; "), "wrap"],
          name === about.robot ? ["this page", "text"] : page ? way : ["no console", "text"],
        ];
      }),
    );
  }
  setInterval(() => others().catch(() => {}), 2000); // a console that is gone is told elsewhere
  link.on("status", show);
  return {
    show: () => {
      show();
      others().catch(() => {});
    },
  };
}
