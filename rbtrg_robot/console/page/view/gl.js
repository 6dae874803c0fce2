// The 3D view on WebGL2. Everything is uploaded in `draw`, the newest only; a lost context is made anew from what the page has.
import { NEVER, UNKNOWN } from "./ground.js";
import { COLOUR, parts as share } from "./palette.js";
import { build } from "./shapes.js";

const TERRAIN = [
  `#version 300 es
layout(location=0) in int height; layout(location=1) in uvec3 marks;
uniform mat4 lens; uniform vec2 corner; uniform float res;
out vec3 at; flat out uvec3 mark;
void main() { int k = gl_VertexID; at = vec3(corner + res * vec2(k % 65, k / 65), float(height) / 1000.0); mark = marks; gl_Position = lens * vec4(at, 1.0); }`,
  `#version 300 es
precision highp float; precision highp int;
in vec3 at; flat in uvec3 mark; uniform int layer; uniform vec2 span; uniform float since; uniform vec3 sky; uniform vec3 eye; uniform vec3 low; uniform vec3 middle; uniform vec3 high; uniform vec3 doubt; uniform vec2 shade; uniform vec4 ink;
out vec4 colour;
vec3 ramp(float t, vec3 a, vec3 b, vec3 c) { return t < 0.5 ? mix(a, b, 2.0 * t) : mix(b, c, 2.0 * t - 1.0); }
void main() {
  vec3 n = normalize(cross(dFdx(at), dFdy(at))); n = n.z < 0.0 ? -n : n;
  float t = clamp((at.z - span.x) / (span.y - span.x), 0.0, 1.0);
  vec3 paint = ramp(t, low, middle, high);
  if (layer == 1) { float r = float(mark.x) / 200.0; paint = mark.x == 255u ? vec3(0.5) : r < 1.0 ? ramp(r, vec3(0.30, 0.60, 0.55), vec3(0.90, 0.80, 0.40), vec3(0.90, 0.45, 0.20)) : vec3(0.62, 0.10, 0.22); }
  if (layer == 2) paint = mark.y <= 1u ? vec3(0.55) : mark.y == 5u ? vec3(0.88, 0.55, 0.25) : mark.y == 2u ? vec3(0.72, 0.72, 0.45) : mark.y == 3u ? vec3(0.35, 0.62, 0.75) : vec3(0.25, 0.70, 0.45);
  if (layer == 3) paint = mark.z == 255u ? vec3(0.5) : ramp(clamp((float(mark.z) + since) / 60.0, 0.0, 1.0), vec3(0.30, 0.72, 0.86), vec3(0.80, 0.72, 0.50), vec3(0.48, 0.26, 0.22));
  if ((mark.y <= 1u || mark.y == 5u) && layer != 3) { float h = fract((at.x + at.y) * 4.0); paint = mix(paint, doubt, h < 0.35 ? 0.45 : 0.15); }
  if (layer == 1 && mark.x >= 200u && mark.x < 255u) { float h = fract((at.x - at.y) * 8.0); paint *= h < 0.4 ? 0.65 : 1.0; }
  float light = shade.x + shade.y * max(0.0, dot(n, normalize(vec3(0.35, -0.45, 0.85))));
  vec2 g = abs(fract(at.xy - 0.5) - 0.5) / fwidth(at.xy);
  float grid = 1.0 - min(min(g.x, g.y), 1.0);
  vec2 fine = fwidth(at.xy);
  paint = mix(paint * light, ink.rgb, ink.a * grid * (1.0 - smoothstep(0.05, 0.25, max(fine.x, fine.y))));
  colour = vec4(mix(paint, sky, smoothstep(30.0, 70.0, distance(at, eye))), 1.0);
}`,
];
const SOLID = [
  `#version 300 es
layout(location=0) in vec3 at; layout(location=1) in vec4 paint; uniform mat4 lens; out vec4 tint;
void main() { tint = paint; gl_Position = lens * vec4(at, 1.0); gl_Position.z -= 0.0004 * gl_Position.w; }`,
  `#version 300 es
precision mediump float; in vec4 tint; out vec4 colour; void main() { colour = tint; }`,
];
const POINTS = [
  `#version 300 es
layout(location=0) in vec3 at; uniform mat4 lens; uniform vec4 turn; uniform vec3 place; uniform float big;
void main() { vec3 p = at / 1000.0; vec3 c = 2.0 * cross(turn.xyz, p); gl_Position = lens * vec4(place + p + turn.w * c + cross(turn.xyz, c), 1.0); gl_PointSize = big; }`,
  `#version 300 es
precision mediump float; out vec4 colour; void main() { colour = vec4(0.10, 0.22, 0.45, 1.0); }`,
];

export function makeGl(canvas, world, ground, camera) {
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, powerPreference: "low-power" });
  if (!gl) return null;
  let parts,
    meshes,
    cloudShown = null,
    graphShown = null;

  function program([vertex, fragment]) {
    const made = gl.createProgram();
    for (const [kind, source] of [
      [gl.VERTEX_SHADER, vertex],
      [gl.FRAGMENT_SHADER, fragment],
    ]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost())
      throw new Error(gl.getProgramInfoLog(made));
    return { made, at: (name) => gl.getUniformLocation(made, name) };
  }
  function layout(...attributes) {
    const made = { array: gl.createVertexArray(), buffers: attributes.map(() => gl.createBuffer()), count: 0 };
    gl.bindVertexArray(made.array);
    attributes.forEach(([size, type, stride, offset, how], k) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, made.buffers[k]);
      gl.enableVertexAttribArray(k);
      if (how === "int") gl.vertexAttribIPointer(k, size, type, stride, offset);
      else gl.vertexAttribPointer(k, size, type, how === "share", stride, offset);
    });
    return made;
  }
  function begin() {
    parts = { terrain: program(TERRAIN), solid: program(SOLID), points: program(POINTS) };
    parts.shapes = layout([3, gl.FLOAT, 0, 0], [4, gl.UNSIGNED_BYTE, 0, 0, "share"]);
    parts.graph = layout([3, gl.FLOAT, 0, 0], [4, gl.UNSIGNED_BYTE, 0, 0, "share"]);
    parts.cloud = layout([3, gl.SHORT, 0, 0]);
    meshes = new Map();
    cloudShown = graphShown = null;
    for (const key of ground.tiles.keys()) ground.dirty.add(key);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  function mesh(key) {
    const tile = ground.tiles.get(key);
    const made = meshes.get(key) ?? {
      ...layout([1, gl.SHORT, 0, 0, "int"], [3, gl.UNSIGNED_BYTE, 0, 0, "int"]),
      index: gl.createBuffer(),
    };
    const N = 64,
      height = new Int16Array(65 * 65),
      marks = new Uint8Array(3 * 65 * 65);
    const beside = (dr, dc) => ground.tiles.get(`${tile.row + dr},${tile.col + dc}`);
    const right = beside(0, N),
      above = beside(N, 0),
      corner = beside(N, N);
    for (let r = 0; r <= N; r++)
      for (let c = 0; c <= N; c++) {
        const from = r < N ? (c < N ? tile : right) : c < N ? above : corner,
          k = (r % N) * N + (c % N),
          v = r * 65 + c;
        height[v] = from ? from.height[k] : UNKNOWN;
        marks[3 * v] = from ? from.risk[k] : 255;
        marks[3 * v + 1] = from ? from.trust[k] : 0;
        marks[3 * v + 2] = from ? from.age[k] : NEVER;
      }
    const index = [];
    for (let r = 0; r < N; r++)
      for (let c = 0; c < N; c++) {
        const a = r * 65 + c,
          b = a + 1,
          d = a + 65,
          e = d + 1;
        if (height[a] !== UNKNOWN && height[b] !== UNKNOWN && height[d] !== UNKNOWN && height[e] !== UNKNOWN)
          index.push(a, b, e, a, e, d);
      }
    gl.bindVertexArray(made.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, made.buffers[0]);
    gl.bufferData(gl.ARRAY_BUFFER, height, gl.STATIC_DRAW);
    gl.bindBuffer(gl.ARRAY_BUFFER, made.buffers[1]);
    gl.bufferData(gl.ARRAY_BUFFER, marks, gl.STATIC_DRAW);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, made.index);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint16Array(index), gl.STATIC_DRAW);
    meshes.set(key, { ...made, count: index.length, tile });
  }

  function upload(part, at, colour) {
    gl.bindVertexArray(part.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, part.buffers[0]);
    gl.bufferData(gl.ARRAY_BUFFER, at, gl.DYNAMIC_DRAW);
    if (colour) {
      gl.bindBuffer(gl.ARRAY_BUFFER, part.buffers[1]);
      gl.bufferData(gl.ARRAY_BUFFER, colour, gl.DYNAMIC_DRAW);
    }
    part.count = at.length / 3;
  }

  function draw() {
    if (gl.isContextLost()) return false;
    if (ground.dirty.has("all")) meshes.clear();
    let budget = 12; // tiles a frame: the page stays quick while a large map comes in
    for (const key of ground.dirty) {
      if (!budget) break;
      ground.dirty.delete(key);
      if (ground.tiles.has(key)) {
        mesh(key);
        budget--;
      }
    }
    const lens = new Float32Array(camera.matrix()),
      sky = share(COLOUR.sky);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...sky, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { terrain, solid, points } = parts;
    gl.useProgram(terrain.made);
    gl.uniformMatrix4fv(terrain.at("lens"), false, lens);
    gl.uniform1f(terrain.at("res"), ground.res);
    gl.uniform1i(terrain.at("layer"), world.layer);
    gl.uniform2f(terrain.at("span"), ground.low, ground.high);
    gl.uniform3f(terrain.at("sky"), ...sky);
    gl.uniform3f(terrain.at("eye"), ...camera.eye());
    ["low", "middle", "high"].forEach((name, k) => gl.uniform3f(terrain.at(name), ...share(COLOUR.ramp[k])));
    gl.uniform3f(terrain.at("doubt"), ...share(COLOUR.doubt));
    gl.uniform2f(terrain.at("shade"), ...COLOUR.shade);
    gl.uniform4f(terrain.at("ink"), ...share(COLOUR.grid[0]), COLOUR.grid[1]);
    const corner = terrain.at("corner"),
      since = terrain.at("since"),
      now = performance.now();
    for (const made of meshes.values()) {
      if (!made.count) continue;
      gl.uniform2f(corner, made.tile.col * ground.res, made.tile.row * ground.res);
      gl.uniform1f(since, (now - made.tile.aged) / 1000);
      gl.bindVertexArray(made.array);
      gl.drawElements(gl.TRIANGLES, made.count, gl.UNSIGNED_SHORT, 0);
    }
    if (world.cloud && world.points) {
      const cloud = world.cloud;
      if (cloud !== cloudShown) {
        upload(parts.cloud, cloud.points);
        cloudShown = cloud;
      }
      gl.useProgram(points.made);
      gl.uniformMatrix4fv(points.at("lens"), false, lens);
      gl.uniform3f(points.at("place"), ...cloud.place);
      gl.uniform4f(points.at("turn"), ...cloud.turn);
      gl.uniform1f(points.at("big"), 2 * (window.devicePixelRatio || 1));
      gl.bindVertexArray(parts.cloud.array);
      gl.drawArrays(gl.POINTS, 0, parts.cloud.count);
    }
    gl.useProgram(solid.made);
    gl.uniformMatrix4fv(solid.at("lens"), false, lens);
    if (world.graph && world.showGraph) {
      if (world.graph !== graphShown) {
        upload(parts.graph, world.graph.at, world.graph.colour);
        graphShown = world.graph;
      }
      gl.bindVertexArray(parts.graph.array);
      gl.drawArrays(gl.LINES, 0, parts.graph.count);
    }
    const shapes = build(world, ground, camera);
    upload(parts.shapes, new Float32Array(shapes.at), new Uint8Array(shapes.colour));
    gl.drawArrays(gl.TRIANGLES, 0, parts.shapes.count);
    return ground.dirty.size > 0;
  }
  begin();
  return {
    kind: "3D",
    draw,
    begin,
    place: (x, y) => ground.hit(...camera.ray(x, y), world.pose ? world.pose.z - 0.42 : 0),
  };
}
