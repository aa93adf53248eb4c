// A view in space that both pages share, drawn by three.js: bodies, lines and points in one scene, turned by pointer and
// keyboard. World z points up.
"use strict";
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const floats = (text) => new Float32Array(bytes(text));
const short = (x) => (!Number.isFinite(x) ? "–" : x === 0 ? "0" : Math.abs(x) >= 1e-4 && Math.abs(x) < 1e6 ? String(+x.toPrecision(4)) : x.toExponential(2));
const by = (id) => document.getElementById(id);
const create = (parent, tag, kind, ...text) => {
  const made = document.createElement(tag);
  if (kind) made.className = kind;
  made.append(...text);
  parent.append(made);
  return made;
};
// A box to tick (or one of several) with its name; `act` is told whether it is on.
const tick = (parent, kind, group, name, on, act) => {
  const label = create(by(parent), "label"), input = create(label, "input");
  Object.assign(input, { type: kind, name: group, value: name, checked: on });
  input.addEventListener("change", () => act(input.checked));
  label.append(name);
  return input;
};
// A colour map from left to right, for a legend.
const ramp = ({ colours }) => `linear-gradient(90deg, ${Array.from({ length: 9 }, (_, i) => `rgb(${colours.subarray(3 * Math.round(i * 255 / 8)).slice(0, 3).join(" ")})`)})`;

// A button that turns the page from light to dark and back, whatever the system prefers.
const themeButton = (redraw) => by("theme").addEventListener("click", () => {
  const root = document.documentElement;
  const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = dark ? "light" : "dark";
  redraw();
});

// Opens the view on a canvas; null without WebGL 2. `pick(x, y)` is told of clicks.
//
// Colours: three.js reckons in linear light and writes sRGB, and nothing maps tones. Shading only scales a colour, and
// for colours that stand for numbers by 0.74 to 1, so that no lamp gives them a false hue.
function openSpace(canvas, pick) {
  const context = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true, alpha: false });
  if (!context) return null;
  const renderer = new THREE.WebGLRenderer({ canvas, context });
  const scene = new THREE.Scene(), world = new THREE.Group();
  scene.add(world);

  // --- materials -----------------------------------------------------------------------------------------
  const srgb = (r, g, b) => new THREE.Color().setRGB(r, g, b, THREE.SRGBColorSpace);
  const themed = [];
  const texture = (pixels, width, height) => {
    const made = new THREE.DataTexture(pixels, width, height);
    made.colorSpace = THREE.SRGBColorSpace;
    made.needsUpdate = true;
    return made;
  };
  // How bright a normal in view is, as a picture of a ball. `lamp` gives at most 1; outside the ball it is clear.
  const ball = (lamp) => {
    const size = 128, pixels = new Uint8Array(4 * size * size);
    for (let i = 0; i < size * size; i++) {
      let [x, y] = [i % size, Math.floor(i / size)].map((at) => ((at + 0.5) / size - 0.5) / 0.495);
      const away = Math.hypot(x, y), rim = Math.max(1, away), n = new THREE.Vector3(x / rim, y / rim, Math.sqrt(Math.max(0, 1 - away * away)));
      const shade = new THREE.Color().setScalar(lamp(n)).convertLinearToSRGB().r;
      pixels.fill(Math.round(255 * shade), 4 * i, 4 * i + 3);
      pixels[4 * i + 3] = away > 1 ? 0 : 255;
    }
    const made = texture(pixels, size, size);
    made.magFilter = made.minFilter = THREE.LinearFilter;
    return made;
  };
  const main = new THREE.Vector3(-0.45, 0.68, 0.64).normalize(), fill = new THREE.Vector3(0.83, 0.06, 0.55).normalize();
  const key = (n) => Math.max(0, (n.dot(main) + 0.18) / 1.18);
  const between = main.clone().add(new THREE.Vector3(0, 0, 1)).normalize(), BRIGHT = 1.36;
  const lit = ball((n) => (0.62 * key(n) + 0.13 * Math.max(0, n.dot(fill)) + 0.34 + 0.09 * n.y + 0.2 * Math.max(0, n.dot(between)) ** 48) / BRIGHT);
  const even = ball((n) => 0.74 + 0.26 * key(n));
  const beads = ball((n) => (0.6 + 0.4 * key(n)) * (n.z < 0.5 ? 0.6 : 1));
  const shaded = (options) => new THREE.MeshMatcapMaterial({ matcap: lit, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 30000, ...options });
  const named = (material, name, scale = 1) => { themed.push({ colour: material.color, name, scale }); return material; };
  // Front in a colour of the page, back in brown.
  const clay = (name, flatShading = false) => [
    named(shaded({ side: THREE.FrontSide, flatShading }), name, BRIGHT),
    shaded({ side: THREE.BackSide, flatShading, color: srgb(0.71, 0.56, 0.42).multiplyScalar(BRIGHT) }),
  ];
  const numbers = (map) => shaded({ matcap: even, map: map.texture, side: THREE.DoubleSide });
  // Stripes of light far away, every 15 degrees around the view's horizontal, as the surface mirrors them.
  const mirror = shaded({ side: THREE.DoubleSide });
  mirror.onBeforeCompile = (shader) => {
    shader.fragmentShader = shader.fragmentShader.replace("vec3 outgoingLight =", `
      vec3 seen = reflect(-viewDir, normal);
      float turn = atan(seen.y, seen.z) * 12., soft = fwidth(turn) + 1e-6;
      float stripe = smoothstep(-soft, soft, sin(turn) / max(1., abs(cos(turn))));
      diffuseColor.rgb = mix(vec3(.013, .022, .033), vec3(.9), stripe) * ${BRIGHT};
      vec3 outgoingLight =`);
  };

  // --- what can be shown ---------------------------------------------------------------------------------
  const add = (made) => {
    made.frustumCulled = false;
    world.add(made);
    return made;
  };
  // Takes it away; its material may serve another, and its program stays ready.
  const remove = (made) => {
    world.remove(made);
    made.geometry.dispose();
  };
  // From 256 colours or fewer, red, green and blue bytes from low to high. A second row is for what is no number.
  const colourMap = (colours) => {
    const count = colours.length / 3, pixels = new Uint8Array(8 * count).fill(199);
    for (let i = 0; i < count; i++) pixels.set(colours.subarray(3 * i, 3 * i + 3), 4 * i);
    for (let i = 3; i < pixels.length; i += 4) pixels[i] = 255;
    const ink = (at) => srgb(...[0, 1, 2].map((i) => pixels[4 * at + i] / 255)).toArray();
    return { colours, inks: Array.from({ length: count }, (_, i) => ink(i)), none: ink(count), texture: texture(pixels, count, 2) };
  };
  // Normals as f32 or as i16 in units of 1/32767; without them triangles are drawn flat.
  const body = (positions, normals, triangles, material) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    if (normals) geometry.setAttribute("normal", new THREE.BufferAttribute(normals, 3, normals instanceof Int16Array));
    geometry.setIndex(new THREE.BufferAttribute(triangles, 1));
    for (const side of [0, 1]) geometry.addGroup(0, triangles.length, side);
    return add(new THREE.Mesh(geometry, material));
  };
  // Colours a body by numbers at its corners.
  const paintBody = (made, values, { low, high }) => {
    const places = new Float32Array(2 * values.length);
    values.forEach((x, i) => places.set(Number.isNaN(x) ? [0, 0.75] : [(x - low) / (high - low), 0.25], 2 * i));
    made.geometry.setAttribute("uv", new THREE.BufferAttribute(places, 2));
  };
  // `segments`: two places each; `width` in pixels; without a colour that of the page's edges.
  const lines = (segments, { width, opacity = 1, colour = null }) => {
    const material = new THREE.LineMaterial({ linewidth: width, opacity, transparent: opacity < 1 });
    if (colour) material.color.copy(srgb(...colour));
    else named(material, "--edge");
    return add(new THREE.LineSegments2(new THREE.LineSegmentsGeometry().setPositions(segments), material));
  };
  // Beads of a radius in pixels, black until they are painted.
  const points = (positions, radius) => {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(positions.length), 3));
    return add(new THREE.Points(geometry, new THREE.PointsMaterial({ size: 2 * radius, sizeAttenuation: false, vertexColors: true, map: beads, alphaTest: 0.5 })));
  };
  // Puts lines or points elsewhere, as many as there were at first; of points the first `count` are shown.
  const move = (made, places, count = Infinity) => {
    const at = made.geometry.getAttribute("instanceStart")?.data || made.geometry.getAttribute("position");
    at.set(places).needsUpdate = true;
    made.geometry.boundingSphere = null;
    if (made.isPoints) made.geometry.setDrawRange(0, count);
  };
  const paintPoints = (made, values, { low, high, map }) => {
    const to = made.geometry.getAttribute("color");
    values.forEach((x, i) => to.setXYZ(i, ...(Number.isNaN(x) ? map.none : map.inks[Math.max(0, Math.min(map.inks.length - 1, Math.floor((x - low) / (high - low) * map.inks.length)))])));
    to.needsUpdate = true;
  };

  // --- camera --------------------------------------------------------------------------------------------
  // The world is scaled so that what is to be seen fits a ball of radius 1.
  const frame = (centre, radius) => {
    world.scale.setScalar(1 / radius);
    world.position.copy(centre).multiplyScalar(-1 / radius);
  };
  const half = 14 * Math.PI / 180, reach = 1 / Math.sin(half), azimuth = -60 * Math.PI / 180, elevation = 25 * Math.PI / 180;
  const camera = new THREE.PerspectiveCamera();
  camera.up.set(0, 0, 1);
  camera.position.set(Math.cos(azimuth) * Math.cos(elevation), Math.sin(azimuth) * Math.cos(elevation), Math.sin(elevation)).multiplyScalar(reach);
  const controls = new THREE.OrbitControls(camera, canvas);
  Object.assign(controls, { minDistance: 0.06 * reach, maxDistance: 4 * reach });
  controls.saveState();

  // --- drawing -------------------------------------------------------------------------------------------
  const paint = () => {
    const width = Math.max(1, canvas.clientWidth), height = Math.max(1, canvas.clientHeight), away = controls.getDistance();
    renderer.setPixelRatio(Math.min(devicePixelRatio || 1, 2.5));
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.fov = 2 * Math.atan(Math.tan(half) / Math.min(1, camera.aspect)) * 180 / Math.PI;
    [camera.near, camera.far] = [0.2 * away, away + 8];
    camera.updateProjectionMatrix();
    const style = getComputedStyle(document.documentElement), css = (name) => style.getPropertyValue(name).trim();
    for (const { colour, name, scale } of themed) colour.set(css(name)).multiplyScalar(scale);
    renderer.setClearColor(css("--stage"));
    renderer.render(scene, camera);
  };
  let waiting = false;
  const draw = () => {
    if (!waiting) requestAnimationFrame(() => { waiting = false; paint(); });
    waiting = true;
  };

  // --- by hand and keyboard ------------------------------------------------------------------------------
  controls.addEventListener("change", draw);
  let from = [0, 0];
  canvas.addEventListener("pointerdown", (event) => {
    from = [event.clientX, event.clientY];
    controls.zoomSpeed = event.pointerType === "touch" ? 1 : 3;
  });
  canvas.addEventListener("wheel", () => { controls.zoomSpeed = 3; }, { capture: true, passive: true });
  canvas.addEventListener("click", (event) => { if (pick && Math.hypot(event.clientX - from[0], event.clientY - from[1]) < 5) pick(event.offsetX, event.offsetY); });
  canvas.addEventListener("dblclick", () => controls.reset());
  canvas.addEventListener("keydown", (event) => {
    const step = Math.PI / 36;
    const keys = {
      ArrowLeft: () => controls.rotateLeft(step), ArrowRight: () => controls.rotateLeft(-step), ArrowUp: () => controls.rotateUp(step), ArrowDown: () => controls.rotateUp(-step),
      "+": () => controls.dollyIn(0.9), "=": () => controls.dollyIn(0.9), "-": () => controls.dollyOut(0.9), 0: () => controls.reset(),
      Enter: () => pick && pick(canvas.clientWidth / 2, canvas.clientHeight / 2),
    };
    if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
  });
  new ResizeObserver(draw).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  addEventListener("beforeprint", paint);

  // --- where things are seen -----------------------------------------------------------------------------
  const caster = new THREE.Raycaster();
  // What lies under a place of the canvas: the nearest hit of `made`, a body, and the nearest of `dots` before it.
  const under = (x, y, made, dots) => {
    caster.setFromCamera(new THREE.Vector2(2 * x / canvas.clientWidth - 1, 1 - 2 * y / canvas.clientHeight), camera);
    const [hit] = made ? caster.intersectObject(made) : [], pixel = 2 * Math.tan(camera.fov * Math.PI / 360) / canvas.clientHeight;
    if (!dots) return { hit };
    const wide = (dots.material.size / 2 + 4) * pixel;
    // What three.js calls the distance to the ray is in the dots' own unit, before the world is scaled.
    caster.params.Points.threshold = 2 * wide * controls.getDistance() / world.scale.x;
    const away = (dot) => dot.distanceToRay * world.scale.x / dot.distance;
    const near = caster.intersectObject(dots).filter((dot) => away(dot) < wide && (!hit || dot.distance < hit.distance + 0.015 * controls.getDistance()));
    return { hit, dot: near.sort((a, b) => away(a) - away(b))[0] };
  };
  // Where a place in space is seen, in pixels of the canvas, and how deep.
  const seen = (place) => {
    const at = world.localToWorld(new THREE.Vector3(...place)), depth = at.distanceTo(camera.position);
    at.project(camera);
    return { x: (at.x + 1) / 2 * canvas.clientWidth, y: (1 - at.y) / 2 * canvas.clientHeight, depth };
  };
  return { frame, body, paintBody, lines, points, move, paintPoints, remove, srgb, colourMap, clay, numbers, mirror, draw, paint, under, seen };
}
