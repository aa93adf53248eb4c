// A view in space that both pages share: WebGL 2 drawing of surfaces, lines and points; a camera turned by pointer and
// keyboard. World z points up.
"use strict";
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const floats = (text) => new Float32Array(bytes(text));
const short = (x) => (!Number.isFinite(x) ? "–" : x === 0 ? "0" : Math.abs(x) >= 1e-4 && Math.abs(x) < 1e6 ? String(+x.toPrecision(4)) : x.toExponential(2));
const by = (id) => document.getElementById(id);
// A colour map from left to right, for a legend.
const ramp = (colours) => `linear-gradient(90deg, ${Array.from({ length: 9 }, (_, i) => { const at = 3 * Math.round(i * 255 / 8); return `rgb(${colours[at]} ${colours[at + 1]} ${colours[at + 2]})`; })})`;
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

// A button that turns the page from light to dark and back, whatever the system prefers.
const themeButton = (redraw) => by("theme").addEventListener("click", () => {
  const root = document.documentElement;
  const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = dark ? "light" : "dark";
  redraw();
});

// Opens the view on a canvas; null without WebGL 2. `hooks.paint(frame)` draws, `hooks.pick(x, y)` is told of clicks.
function openSpace(canvas, hooks) {
  const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) return null;

  // --- shaders -----------------------------------------------------------------------------------------
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
    }
    // Colours that stand for numbers: shape shows, but no highlight and no deep shade gives them a false hue.
    vec3 even(vec3 n, vec3 colour) {
      float lamp = max(0., (dot(n, normalize(vec3(-.45, .68, .64))) + .18) / 1.18);
      return colour * pow(.74 + .26 * lamp, 1. / 2.2);
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
      if (mode == 1) base = isnan(v) ? vec3(.78) : texture(map, vec2(clamp((v - low) / (high - low), .002, .998), .5)).rgb;
      if (inside && mode != 1) base = vec3(.71, .56, .42);
      if (mode == 2) {
        vec3 r = reflect(normalize(p), m);
        float s = atan(r.y, r.z) * 12.;
        float w = fwidth(s) + 1e-6;
        float stripe = smoothstep(-w, w, sin(s) / max(1., abs(cos(s))));
        base = mix(vec3(.12, .16, .2), vec3(.95), stripe);
      }
      colour = vec4(mode == 1 ? even(m, base) : lit(m, base), 1.);
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
      vec3 base = isnan(v) ? vec3(.5) : texture(map, vec2(clamp((v - low) / (high - low), .002, .998), .5)).rgb;
      colour = vec4(lit(vec3(d.x, -d.y, sqrt(1. - r)), base) * (r > .75 ? .72 : 1.), 1.);
    }`);

  // --- buffers -----------------------------------------------------------------------------------------
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
  const arrays = (buffers, attach) => {
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    attach();
    gl.bindVertexArray(null);
    return { array, free: () => { gl.deleteVertexArray(array); buffers.forEach((b) => gl.deleteBuffer(b)); } };
  };
  // A colour map from red, green, blue bytes; `steps` keeps the colours apart instead of blending them.
  const texture = (colours, steps = false) => {
    const made = gl.createTexture();
    const filter = steps ? gl.NEAREST : gl.LINEAR;
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, colours.length / 3, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, colours);
    for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, filter], [gl.TEXTURE_MAG_FILTER, filter], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) gl.texParameteri(gl.TEXTURE_2D, name, value);
    return { texture: made, colours };
  };
  // Normals as f32 or as i16 in units of 1/32767.
  const surface = (positions, normals, triangles, values) => {
    const value = values || new Float32Array(positions.length / 3);
    const all = [buffer(positions), buffer(normals), buffer(value)];
    gl.bindVertexArray(null);
    const index = buffer(triangles, gl.ELEMENT_ARRAY_BUFFER);
    const made = arrays([...all, index], () => {
      attribute(surfaceProgram, "position", all[0], 3);
      if (normals instanceof Int16Array) attribute(surfaceProgram, "normal", all[1], 3, gl.SHORT, 0, 6);
      else attribute(surfaceProgram, "normal", all[1], 3);
      attribute(surfaceProgram, "value", all[2], 1);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, index);
    });
    const paint = (numbers) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, all[2]);
      gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.STATIC_DRAW);
    };
    return { ...made, paint, count: triangles.length };
  };
  const corners = buffer(new Float32Array([0, -1, 1, -1, 0, 1, 1, 1]));
  const lines = (segments) => {
    const ends = buffer(segments);
    const made = arrays([ends], () => {
      attribute(lineProgram, "corner", corners, 2);
      attribute(lineProgram, "from", ends, 3, gl.FLOAT, 1, 24, 0);
      attribute(lineProgram, "to", ends, 3, gl.FLOAT, 1, 24, 12);
    });
    return { ...made, count: segments.length / 6 };
  };
  const points = (positions, values) => {
    const all = [buffer(positions), buffer(values)];
    const made = arrays(all, () => {
      attribute(pointProgram, "position", all[0], 3);
      attribute(pointProgram, "value", all[1], 1);
    });
    const paint = (numbers) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, all[1]);
      gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.STATIC_DRAW);
    };
    return { ...made, paint, count: values.length };
  };

  // --- camera ------------------------------------------------------------------------------------------
  const start = { azimuth: -60, elevation: 25, distance: 1, target: [0, 0, 0] };
  const camera = { ...start, target: [...start.target] };
  const home = { centre: [0, 0, 0], radius: 1 };
  const halfAngle = 14 * Math.PI / 180;
  const axes = () => {
    const a = camera.azimuth * Math.PI / 180, e = camera.elevation * Math.PI / 180;
    const right = [-Math.sin(a), Math.cos(a), 0];
    const back = [Math.cos(a) * Math.cos(e), Math.sin(a) * Math.cos(e), Math.sin(e)];
    const up = [back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2], back[0] * right[1] - back[1] * right[0]];
    return { right, up, back };
  };
  const target = () => camera.target.map((x, i) => x + home.centre[i]);
  // The distance at which a ball around everything just fits.
  const reach = () => {
    const aspect = canvas.clientWidth / canvas.clientHeight || 1;
    return home.radius / Math.sin(Math.min(halfAngle, Math.atan(Math.tan(halfAngle) * aspect)));
  };
  const matrices = () => {
    const { right, up, back } = axes();
    const far = reach() * camera.distance, t = target();
    const look = [right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0, -dot(right, t), -dot(up, t), -dot(back, t) - far, 1];
    const near = Math.max(far - 6 * home.radius, far * 0.01), end = far + 6 * home.radius;
    const f = 1 / Math.tan(halfAngle), aspect = canvas.width / canvas.height;
    const project = [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (end + near) / (near - end), -1, 0, 0, 2 * end * near / (near - end), 0];
    return { look, project };
  };
  // Where a place of the canvas looks: eye, direction (of depth 1), and the numbers that place it on the screen.
  const sight = (x, y) => {
    const { right, up, back } = axes();
    const far = reach() * camera.distance, t = target();
    const eye = [0, 1, 2].map((i) => t[i] + back[i] * far);
    const tall = Math.tan(halfAngle), wide = tall * canvas.clientWidth / canvas.clientHeight;
    const sx = (2 * x / canvas.clientWidth - 1) * wide, sy = (1 - 2 * y / canvas.clientHeight) * tall;
    return { eye, right, up, back, tall, sx, sy, ray: [0, 1, 2].map((i) => right[i] * sx + up[i] * sy - back[i]) };
  };
  // Where a place in space is seen, in pixels of the canvas, and how deep.
  const project = (p) => {
    const { eye, right, up, back, tall } = sight(0, 0);
    const d = [0, 1, 2].map((i) => p[i] - eye[i]), depth = -dot(d, back);
    const scale = canvas.clientHeight / 2 / tall / depth;
    return { x: canvas.clientWidth / 2 + dot(d, right) * scale, y: canvas.clientHeight / 2 - dot(d, up) * scale, depth };
  };

  // --- drawing -----------------------------------------------------------------------------------------
  const root = document.documentElement;
  const ink = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
  const css = (name) => {
    ink.fillStyle = getComputedStyle(root).getPropertyValue(name).trim();
    ink.fillRect(0, 0, 1, 1);
    return Array.from(ink.getImageData(0, 0, 1, 1).data.slice(0, 3), (x) => x / 255);
  };
  let waiting = false;
  const draw = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; paint(); });
  };
  const paint = () => {
    const scale = Math.min(devicePixelRatio || 1, 2.5);
    const width = Math.max(1, Math.round(canvas.clientWidth * scale)), height = Math.max(1, Math.round(canvas.clientHeight * scale));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const { look, project } = matrices();
    gl.viewport(0, 0, width, height);
    gl.clearColor(...css("--stage"), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const use = ({ built, uniforms }) => {
      gl.useProgram(built);
      gl.uniformMatrix4fv(uniforms.look, false, look);
      gl.uniformMatrix4fv(uniforms.project, false, project);
      return uniforms;
    };
    const range = (uniforms, { low = 0, high = 1, map }) => {
      gl.uniform1f(uniforms.low, low);
      gl.uniform1f(uniforms.high, high);
      if (map) gl.bindTexture(gl.TEXTURE_2D, map.texture);
    };
    hooks.paint({
      css,
      // mode 0 plain, 1 by value, 2 reflection lines
      surface(made, { mode = 0, clay = css("--clay"), ...values }) {
        const uniforms = use(surfaceProgram);
        gl.disable(gl.BLEND);
        gl.enable(gl.POLYGON_OFFSET_FILL);
        gl.polygonOffset(1, 1);
        gl.uniform1i(uniforms.mode, mode);
        gl.uniform3fv(uniforms.clay, clay);
        range(uniforms, values);
        gl.bindVertexArray(made.array);
        gl.drawElements(gl.TRIANGLES, made.count, gl.UNSIGNED_INT, 0);
        gl.disable(gl.POLYGON_OFFSET_FILL);
      },
      points(made, { radius, ...values }) {
        const uniforms = use(pointProgram);
        gl.disable(gl.BLEND);
        gl.uniform1f(uniforms.radius, radius * scale);
        gl.uniform1f(uniforms.bias, 4e-4);
        range(uniforms, values);
        gl.bindVertexArray(made.array);
        gl.drawArrays(gl.POINTS, 0, made.count);
      },
      lines(made, { width: thick, opacity = 1, colour = css("--edge"), bias = 5e-4 }) {
        if (!made.count) return;
        const uniforms = use(lineProgram);
        gl.enable(gl.BLEND);
        gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
        gl.uniform2f(uniforms.size, width, height);
        gl.uniform1f(uniforms.width, thick * scale);
        gl.uniform1f(uniforms.bias, bias);
        gl.uniform4fv(uniforms.ink, [...colour, opacity]);
        gl.bindVertexArray(made.array);
        gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, made.count);
      },
    });
    gl.bindVertexArray(null);
  };

  // --- by hand and keyboard ----------------------------------------------------------------------------
  const held = new Map();
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
  const all = () => { Object.assign(camera, start, { target: [...start.target] }); draw(); };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (held.size === 1) moved = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = held.get(event.pointerId);
    if (!last) return;
    const [dx, dy] = [event.offsetX - last[0], event.offsetY - last[1]];
    moved += Math.abs(dx) + Math.abs(dy);
    if (held.size === 2) {
      const other = [...held].find(([id]) => id !== event.pointerId)[1];
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      zoom(apart(last) / Math.max(1, apart([event.offsetX, event.offsetY])));
      shift(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons === 2 || event.buttons === 4) shift(dx, dy);
    else turn(dx, dy);
    held.set(event.pointerId, [event.offsetX, event.offsetY]);
    draw();
  });
  const lift = (event) => {
    if (held.delete(event.pointerId) && held.size === 0 && moved < 5 && event.type === "pointerup" && hooks.pick) hooks.pick(event.offsetX, event.offsetY);
  };
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(Math.max(-60, Math.min(60, event.deltaY)) * 0.004)); draw(); }, { passive: false });
  canvas.addEventListener("dblclick", all);
  canvas.addEventListener("keydown", (event) => {
    const step = 12;
    const keys = {
      ArrowLeft: () => turn(step, 0), ArrowRight: () => turn(-step, 0), ArrowUp: () => turn(0, step), ArrowDown: () => turn(0, -step),
      "+": () => zoom(0.9), "=": () => zoom(0.9), "-": () => zoom(1.1), 0: all,
      Enter: () => hooks.pick && hooks.pick(canvas.clientWidth / 2, canvas.clientHeight / 2),
    };
    if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
    draw();
  });
  new ResizeObserver(() => draw()).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => draw());
  addEventListener("beforeprint", paint);
  return { home, surface, lines, points, texture, draw, paint, sight, project };
}
