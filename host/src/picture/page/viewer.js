// The three-dimensional view of the report page: WebGL 2, no library, no network.
"use strict";
(() => {
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const canvas = document.getElementById("view");
  const root = document.documentElement;
  const by = (id) => document.getElementById(id);

  document.getElementById("theme").addEventListener("click", () => {
    const dark = root.dataset.theme
      ? root.dataset.theme === "dark"
      : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
    draw();
  });

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const floats = (text) => new Float32Array(bytes(text));
  const short = (x) => (x === 0 ? "0" : Math.abs(x) >= 1e-4 && Math.abs(x) < 1e6 ? String(+x.toPrecision(4)) : x.toExponential(2));
  const unit = scene.unit ? " " + scene.unit : "";

  const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) {
    canvas.remove();
    by("layers").querySelectorAll("fieldset").forEach((part) => part.remove());
    by("layers").querySelector(".hint").textContent = "This browser shows no WebGL 2, so here is a still picture.";
    var draw = () => {};
    return;
  }
  by("poster").remove();

  // --- shaders -------------------------------------------------------------------------------------------
  const program = (vertex, fragment) => {
    const built = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, "#version 300 es\nprecision highp float;\n" + source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(built, shader);
    }
    gl.linkProgram(built);
    if (!gl.getProgramParameter(built, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(built));
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(built, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(built, i);
      uniforms[name] = gl.getUniformLocation(built, name);
    }
    return { built, uniforms };
  };
  const light = `
    vec3 lit(vec3 n, vec3 colour) {
      vec3 main = normalize(vec3(-.45, .68, .64)), fill = normalize(vec3(.83, .06, .55));
      float lamps = .62 * max(0., (dot(n, main) + .18) / 1.18) + .13 * max(0., dot(n, fill));
      float gloss = .07 * pow(max(0., dot(n, normalize(main + vec3(0, 0, 1)))), 48.);
      vec3 linear = pow(colour, vec3(2.2)) * (lamps + .34 + .09 * n.y) + gloss;
      return pow(linear, vec3(1. / 2.2));
    }`;
  const surfaceProgram = program(`
    in vec3 position; in vec3 normal; in float value;
    uniform mat4 project; uniform mat4 look;
    out vec3 n; out vec3 p; out float v;
    void main() {
      vec4 at = look * vec4(position, 1.);
      n = mat3(look) * normal; p = at.xyz; v = value;
      gl_Position = project * at;
    }`, `
    in vec3 n; in vec3 p; in float v; out vec4 colour;
    uniform int mode; uniform vec3 clay; uniform float low, high; uniform sampler2D map;
    ${light}
    void main() {
      vec3 m = normalize(n);
      bool inside = dot(m, p) > 0.;
      if (inside) m = -m;
      vec3 base = clay;
      if (mode == 1) base = texture(map, vec2(clamp((v - low) / (high - low), .002, .998), .5)).rgb;
      if (inside) base = vec3(.71, .56, .42);
      if (mode == 2) {
        vec3 r = reflect(normalize(p), m);
        float s = atan(r.y, r.z) * 12.;
        float w = fwidth(s) + 1e-6;
        float stripe = smoothstep(-w, w, sin(s) / max(1., abs(cos(s))));
        base = mix(vec3(.12, .16, .2), vec3(.95), stripe);
      }
      colour = vec4(lit(m, base), 1.);
    }`);
  const lineProgram = program(`
    in vec2 corner; in vec3 from; in vec3 to;
    uniform mat4 project; uniform mat4 look; uniform vec2 size; uniform float width, bias;
    void main() {
      vec4 a = project * look * vec4(from, 1.), b = project * look * vec4(to, 1.);
      vec2 along = (b.xy / b.w - a.xy / a.w) * size;
      along = length(along) > 0. ? normalize(along) : vec2(1, 0);
      vec4 at = mix(a, b, corner.x);
      vec2 off = (vec2(-along.y, along.x) * corner.y + along * (corner.x * 2. - 1.) * .5) * width / size;
      at.xy += off * at.w;
      at.z -= bias * at.w;
      gl_Position = at;
    }`, `
    uniform vec4 ink; out vec4 colour;
    void main() { colour = vec4(ink.rgb * ink.a, ink.a); }`);
  const pointProgram = program(`
    in vec3 position; in float value;
    uniform mat4 project; uniform mat4 look; uniform float radius, bias;
    out float v;
    void main() {
      v = value;
      gl_Position = project * look * vec4(position, 1.);
      gl_Position.z -= bias * gl_Position.w;
      gl_PointSize = 2. * radius;
    }`, `
    in float v; uniform float low, high; uniform sampler2D map; out vec4 colour;
    ${light}
    void main() {
      vec2 d = gl_PointCoord * 2. - 1.;
      float r = dot(d, d);
      if (r > 1.) discard;
      vec3 base = texture(map, vec2(clamp((v - low) / (high - low), .002, .998), .5)).rgb;
      colour = vec4(lit(vec3(d.x, -d.y, sqrt(1. - r)), base) * (r > .75 ? .72 : 1.), 1.);
    }`);

  // --- buffers -------------------------------------------------------------------------------------------
  const buffer = (data, kind = gl.ARRAY_BUFFER) => {
    const made = gl.createBuffer();
    gl.bindBuffer(kind, made);
    gl.bufferData(kind, data, gl.STATIC_DRAW);
    return made;
  };
  const attribute = ({ built }, name, data, count, type = gl.FLOAT, divisor = 0, stride = 0, offset = 0) => {
    const place = gl.getAttribLocation(built, name);
    if (place < 0) return;
    gl.bindBuffer(gl.ARRAY_BUFFER, data);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, count, type, type !== gl.FLOAT, stride, offset);
    gl.vertexAttribDivisor(place, divisor);
  };
  const texture = (text) => {
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, new Uint8Array(bytes(text)));
    for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) gl.texParameteri(gl.TEXTURE_2D, name, value);
    return made;
  };
  const maps = Object.fromEntries(Object.entries(scene.maps).map(([name, text]) => [name, { texture: texture(text), colours: new Uint8Array(bytes(text)) }]));

  const mesh = {
    positions: floats(scene.surface.positions),
    normals: new Int16Array(bytes(scene.surface.normals)),
    triangles: new Uint32Array(bytes(scene.surface.triangles)),
    patches: new Uint32Array(bytes(scene.surface.patches)),
  };
  const fields = scene.fields.map((field) => ({ ...field, values: floats(field.values) }));
  const positionBuffer = buffer(mesh.positions);
  const normalBuffer = buffer(mesh.normals);
  const indexBuffer = buffer(mesh.triangles, gl.ELEMENT_ARRAY_BUFFER);
  const noValues = buffer(new Float32Array(mesh.positions.length / 3));
  const surfaces = [{ name: "shape alone", mode: 0, values: noValues }, { name: "reflection lines", mode: 2, values: noValues }];
  for (const field of fields) surfaces.push({ name: field.name, mode: 1, values: buffer(field.values), field });
  for (const surface of surfaces) {
    surface.array = gl.createVertexArray();
    gl.bindVertexArray(surface.array);
    attribute(surfaceProgram, "position", positionBuffer, 3);
    attribute(surfaceProgram, "normal", normalBuffer, 3, gl.SHORT, 0, 6);
    attribute(surfaceProgram, "value", surface.values, 1);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, indexBuffer);
  }
  const corners = buffer(new Float32Array([0, -1, 1, -1, 0, 1, 1, 1]));
  const lines = scene.lines.map((layer) => {
    const data = floats(layer.segments);
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const ends = buffer(data);
    attribute(lineProgram, "corner", corners, 2);
    attribute(lineProgram, "from", ends, 3, gl.FLOAT, 1, 24, 0);
    attribute(lineProgram, "to", ends, 3, gl.FLOAT, 1, 24, 12);
    return { ...layer, array, count: data.length / 6 };
  });
  let points = null;
  if (scene.points) {
    points = { ...scene.points, positions: floats(scene.points.positions), values: floats(scene.points.distances), angles: floats(scene.points.angles) };
    points.array = gl.createVertexArray();
    gl.bindVertexArray(points.array);
    attribute(pointProgram, "position", buffer(points.positions), 3);
    attribute(pointProgram, "value", buffer(points.values), 1);
  }
  gl.bindVertexArray(null);

  // --- layers --------------------------------------------------------------------------------------------
  let shown = surfaces[0];
  const overlays = { points: points !== null };
  const choice = (parent, kind, name, checked, act) => {
    const label = document.createElement("label");
    const input = document.createElement("input");
    input.type = kind;
    input.name = kind === "radio" ? "surface" : name;
    input.checked = checked;
    input.addEventListener("change", () => { act(input.checked); draw(); });
    label.append(input, name);
    parent.append(label);
  };
  let solid = true;
  surfaces.forEach((surface) => choice(by("colours"), "radio", surface.name, surface === shown, () => { shown = surface; }));
  choice(by("overlays"), "checkbox", "surface", true, (on) => { solid = on; });
  if (points) choice(by("overlays"), "checkbox", "points by distance", true, (on) => { overlays.points = on; });
  lines.forEach((layer) => choice(by("overlays"), "checkbox", layer.name, layer.on, (on) => { layer.on = on; }));

  const legend = () => {
    const field = shown.field || (points && overlays.points ? { name: "distance of the points" + (scene.unit ? ", " + scene.unit : ""), low: 0, high: points.high, map: "viridis" } : null);
    by("legend").hidden = !field;
    if (!field) return;
    const { colours } = maps[field.map];
    const stops = Array.from({ length: 9 }, (_, i) => { const at = 3 * Math.round(i * 255 / 8); return `rgb(${colours[at]} ${colours[at + 1]} ${colours[at + 2]})`; });
    by("legend-name").textContent = field.name;
    by("legend-bar").style.background = `linear-gradient(90deg, ${stops})`;
    by("legend-low").textContent = short(field.low);
    by("legend-high").textContent = short(field.high);
  };

  // --- camera --------------------------------------------------------------------------------------------
  const start = { azimuth: -60, elevation: 25, distance: 1, target: [0, 0, 0] };
  const camera = { ...start, target: [...start.target] };
  const halfAngle = 14 * Math.PI / 180;
  const axes = () => {
    const a = camera.azimuth * Math.PI / 180, e = camera.elevation * Math.PI / 180;
    const right = [-Math.sin(a), Math.cos(a), 0];
    const back = [Math.cos(a) * Math.cos(e), Math.sin(a) * Math.cos(e), Math.sin(e)];
    const up = [back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2], back[0] * right[1] - back[1] * right[0]];
    return { right, up, back };
  };
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  // The distance at which a ball around everything just fits.
  const reach = () => {
    const aspect = canvas.width / canvas.height || 1;
    return scene.radius / Math.sin(Math.min(halfAngle, Math.atan(Math.tan(halfAngle) * aspect)));
  };
  const matrices = () => {
    const { right, up, back } = axes();
    const far = reach() * camera.distance, t = camera.target;
    const look = [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0, -dot(right, t), -dot(up, t), -dot(back, t) - far, 1];
    const near = Math.max(far - 4 * scene.radius, far * 0.01), end = far + 4 * scene.radius;
    const f = 1 / Math.tan(halfAngle), aspect = canvas.width / canvas.height;
    const project = [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (end + near) / (near - end), -1, 0, 0, 2 * end * near / (near - end), 0];
    return { look, project, far };
  };

  // --- drawing -------------------------------------------------------------------------------------------
  const css = (name) => {
    const context = css.context || (css.context = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true }));
    context.fillStyle = getComputedStyle(root).getPropertyValue(name).trim();
    context.fillRect(0, 0, 1, 1);
    return Array.from(context.getImageData(0, 0, 1, 1).data.slice(0, 3), (x) => x / 255);
  };
  let waiting = false;
  function draw() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; paint(); });
  }
  const paint = () => {
    const scale = Math.min(devicePixelRatio || 1, 2.5);
    const width = Math.max(1, Math.round(canvas.clientWidth * scale)), height = Math.max(1, Math.round(canvas.clientHeight * scale));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const { look, project } = matrices();
    const ground = css("--stage");
    gl.viewport(0, 0, width, height);
    gl.clearColor(...ground, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    if (solid) {
      const { built, uniforms } = surfaceProgram;
      gl.useProgram(built);
      gl.uniformMatrix4fv(uniforms.look, false, look);
      gl.uniformMatrix4fv(uniforms.project, false, project);
      gl.uniform1i(uniforms.mode, shown.mode);
      gl.uniform3fv(uniforms.clay, css("--clay"));
      gl.uniform1f(uniforms.low, shown.field ? shown.field.low : 0);
      gl.uniform1f(uniforms.high, shown.field ? shown.field.high : 1);
      gl.bindTexture(gl.TEXTURE_2D, maps[shown.field ? shown.field.map : "viridis"].texture);
      gl.bindVertexArray(shown.array);
      gl.drawElements(gl.TRIANGLES, mesh.triangles.length, gl.UNSIGNED_INT, 0);
    }
    if (points && overlays.points) {
      const { built, uniforms } = pointProgram;
      gl.useProgram(built);
      gl.uniformMatrix4fv(uniforms.look, false, look);
      gl.uniformMatrix4fv(uniforms.project, false, project);
      gl.uniform1f(uniforms.radius, points.radius * scale);
      gl.uniform1f(uniforms.bias, 4e-4);
      gl.uniform1f(uniforms.low, 0);
      gl.uniform1f(uniforms.high, points.high);
      gl.bindTexture(gl.TEXTURE_2D, maps.viridis.texture);
      gl.bindVertexArray(points.array);
      gl.drawArrays(gl.POINTS, 0, points.values.length);
    }
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    for (const layer of lines) {
      if (!layer.on || !layer.count) continue;
      const { built, uniforms } = lineProgram;
      gl.useProgram(built);
      gl.uniformMatrix4fv(uniforms.look, false, look);
      gl.uniformMatrix4fv(uniforms.project, false, project);
      gl.uniform2f(uniforms.size, width, height);
      gl.uniform1f(uniforms.width, layer.width * scale);
      gl.uniform1f(uniforms.bias, 5e-4);
      gl.uniform4fv(uniforms.ink, [...(layer.colour ? layer.colour : css("--edge")), layer.opacity]);
      gl.bindVertexArray(layer.array);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, layer.count);
    }
    gl.bindVertexArray(null);
    legend();
  };

  // --- picking -------------------------------------------------------------------------------------------
  const vertex = (i) => mesh.positions.subarray(3 * i, 3 * i + 3);
  const place = (p) => [0, 1, 2].map((i) => short(p[i] + scene.centre[i])).join(", ");
  const pick = (x, y) => {
    const { right, up, back } = axes();
    const far = reach() * camera.distance;
    const eye = [0, 1, 2].map((i) => camera.target[i] + back[i] * far);
    const tall = Math.tan(halfAngle), wide = tall * canvas.clientWidth / canvas.clientHeight;
    const sx = (2 * x / canvas.clientWidth - 1) * wide, sy = (1 - 2 * y / canvas.clientHeight) * tall;
    const ray = [0, 1, 2].map((i) => right[i] * sx + up[i] * sy - back[i]);
    let hit = null;
    if (solid) for (let t = 0; t < mesh.patches.length; t++) {
      const [ia, ib, ic] = mesh.triangles.subarray(3 * t, 3 * t + 3);
      const a = vertex(ia), b = vertex(ib), c = vertex(ic);
      const u = [b[0] - a[0], b[1] - a[1], b[2] - a[2]], v = [c[0] - a[0], c[1] - a[1], c[2] - a[2]];
      const h = [ray[1] * v[2] - ray[2] * v[1], ray[2] * v[0] - ray[0] * v[2], ray[0] * v[1] - ray[1] * v[0]];
      const d = dot(u, h);
      if (d === 0) continue;
      const s = [eye[0] - a[0], eye[1] - a[1], eye[2] - a[2]];
      const m = dot(s, h) / d;
      if (m < 0 || m > 1) continue;
      const q = [s[1] * u[2] - s[2] * u[1], s[2] * u[0] - s[0] * u[2], s[0] * u[1] - s[1] * u[0]];
      const n = dot(ray, q) / d;
      if (n < 0 || m + n > 1) continue;
      const depth = dot(v, q) / d;
      if (depth > 0 && (!hit || depth < hit.depth)) hit = { depth, triangle: t, corners: [ia, ib, ic], shares: [1 - m - n, m, n] };
    }
    let near = null;
    if (points && overlays.points) for (let i = 0; i < points.values.length; i++) {
      const p = [0, 1, 2].map((k) => points.positions[3 * i + k] - eye[k]);
      const depth = -dot(p, back);
      const dx = (dot(p, right) / depth - sx) / tall * canvas.clientHeight / 2, dy = (dot(p, up) / depth - sy) / tall * canvas.clientHeight / 2;
      const away = Math.hypot(dx, dy);
      if (away < points.radius + 4 && (!hit || depth < hit.depth + 0.03 * scene.radius) && (!near || away < near.away)) near = { away, i };
    }
    const out = by("picked");
    out.hidden = !(near || hit);
    if (near) {
      const p = points.positions.subarray(3 * near.i, 3 * near.i + 3);
      out.textContent = `Point ${near.i + 1} at ${place(p)}${unit}\ndistance to the surface ${short(points.values[near.i])}${unit}\nangle between normals ${short(points.angles[near.i])}°`;
    } else if (hit) {
      const mix = (f) => hit.shares.reduce((sum, share, k) => sum + share * f(hit.corners[k]), 0);
      const at = [0, 1, 2].map((i) => mix((v) => mesh.positions[3 * v + i]));
      const normal = [0, 1, 2].map((i) => mix((v) => mesh.normals[3 * v + i] / 32767));
      const values = fields.map((field) => `${field.name}: ${short(mix((v) => field.values[v]))}`);
      out.textContent = [`Patch ${mesh.patches[hit.triangle]} at ${place(at)}${unit}`, `normal ${normal.map((x) => x.toFixed(3)).join(", ")}`, ...values].join("\n");
    }
  };

  // --- hands ---------------------------------------------------------------------------------------------
  const fingers = new Map();
  let moved = 0;
  const turn = (dx, dy) => {
    camera.azimuth -= dx * 0.4;
    camera.elevation = Math.max(-90, Math.min(90, camera.elevation + dy * 0.4));
  };
  const shift = (dx, dy) => {
    const { right, up } = axes();
    const step = 2 * Math.tan(halfAngle) * reach() * camera.distance / canvas.clientHeight;
    camera.target = camera.target.map((x, i) => x - right[i] * dx * step + up[i] * dy * step);
  };
  const zoom = (factor) => { camera.distance = Math.max(0.06, Math.min(4, camera.distance * factor)); };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (fingers.size === 1) moved = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const [dx, dy] = [event.offsetX - last[0], event.offsetY - last[1]];
    moved += Math.abs(dx) + Math.abs(dy);
    if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      zoom(apart(last) / Math.max(1, apart([event.offsetX, event.offsetY])));
      shift(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons === 2 || event.buttons === 4) shift(dx, dy);
    else turn(dx, dy);
    fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    draw();
  });
  const lift = (event) => {
    if (fingers.delete(event.pointerId) && fingers.size === 0 && moved < 5 && event.type === "pointerup") pick(event.offsetX, event.offsetY);
  };
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(Math.max(-60, Math.min(60, event.deltaY)) * 0.004)); draw(); }, { passive: false });
  const all = () => { Object.assign(camera, start, { target: [...start.target] }); draw(); };
  canvas.addEventListener("dblclick", all);
  canvas.addEventListener("keydown", (event) => {
    const step = 12;
    const keys = {
      ArrowLeft: () => turn(step, 0), ArrowRight: () => turn(-step, 0), ArrowUp: () => turn(0, step), ArrowDown: () => turn(0, -step),
      "+": () => zoom(0.9), "=": () => zoom(0.9), "-": () => zoom(1.1), 0: all,
      Enter: () => pick(canvas.clientWidth / 2, canvas.clientHeight / 2),
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
    draw();
  });
  new ResizeObserver(() => draw()).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => draw());
  addEventListener("beforeprint", paint);
  paint();
})();
