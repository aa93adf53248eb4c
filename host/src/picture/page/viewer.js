// The three-dimensional view of the report page.
(() => {
  const scene = JSON.parse(by("scene").textContent);
  const canvas = by("view");
  const unit = scene.unit ? " " + scene.unit : "";
  const space = openSpace(canvas, { paint: (frame) => paint(frame), pick: (x, y) => pick(x, y) });
  themeButton(() => space && space.draw());
  if (!space) {
    canvas.remove();
    by("layers").querySelectorAll("fieldset").forEach((part) => part.remove());
    by("layers").querySelector(".hint").textContent = "This browser shows no WebGL 2, so here is a still picture.";
    return;
  }
  by("poster").remove();
  space.home.radius = scene.radius;

  // --- what there is to draw -----------------------------------------------------------------------------
  const maps = Object.fromEntries(Object.entries(scene.maps).map(([name, text]) => [name, space.texture(new Uint8Array(bytes(text)))]));
  const fields = scene.fields.map((field) => ({ ...field, values: floats(field.values) }));
  const indices = (text) => new Uint32Array(bytes(text));
  const smooth = { positions: floats(scene.surface.positions), normals: new Int16Array(bytes(scene.surface.normals)), triangles: indices(scene.surface.triangles), patches: indices(scene.surface.patches) };
  const bodies = [{ name: "surface", mesh: smooth, made: space.surface(smooth.positions, smooth.normals, smooth.triangles) }];
  // A mesh with flat triangles and its edges as lines.
  for (const { name, positions: text, triangles } of scene.meshes) {
    const at = floats(text), faces = indices(triangles), seen = new Set(), edges = [];
    const mesh = { positions: new Float32Array(3 * faces.length), normals: new Float32Array(3 * faces.length), triangles: Uint32Array.from(faces, (_, i) => i), patches: null };
    for (let t = 0; t < faces.length; t += 3) {
      const [a, b, c] = [0, 1, 2].map((k) => at.subarray(3 * faces[t + k], 3 * faces[t + k] + 3));
      const u = [0, 1, 2].map((i) => b[i] - a[i]), v = [0, 1, 2].map((i) => c[i] - a[i]);
      const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]], size = Math.hypot(...n) || 1;
      [a, b, c].forEach((p, k) => { mesh.positions.set(p, 3 * (t + k)); mesh.normals.set(n.map((x) => x / size), 3 * (t + k)); });
      for (let k = 0; k < 3; k++) {
        const [i, j] = [faces[t + k], faces[t + (k + 1) % 3]], key = Math.min(i, j) * 4294967296 + Math.max(i, j);
        if (!seen.has(key)) { seen.add(key); edges.push(...at.subarray(3 * i, 3 * i + 3), ...at.subarray(3 * j, 3 * j + 3)); }
      }
    }
    const thin = Math.max(0.3, Math.min(1, Math.sqrt(3000 * 6 / edges.length)));
    bodies.push({ name, mesh, made: space.surface(mesh.positions, mesh.normals, mesh.triangles), edges: space.lines(new Float32Array(edges)), width: 1.4 * thin, opacity: Math.max(0.35, 0.85 * thin) });
  }
  const looks = [{ name: "shape alone", mode: 0 }, ...fields.map((field) => ({ name: field.name, mode: 1, field })), { name: "reflection lines", mode: 2 }];
  const lines = scene.lines.map((layer) => ({ ...layer, made: space.lines(floats(layer.segments)) }));
  let points = null;
  const pointLooks = [];
  if (scene.points) {
    const { positions, distances, angles, fingers } = scene.points;
    points = { ...scene.points, positions: floats(positions), distances: floats(distances), angles: floats(angles), fingers: fingers ? new Uint8Array(bytes(fingers)) : null };
    points.made = space.points(points.positions, points.distances);
    pointLooks.push({ name: "distance to the surface", label: "distance of the points" + (scene.unit ? ", " + scene.unit : ""), low: 0, high: points.high, map: maps.viridis, values: points.distances });
    pointLooks.push({ name: "angle between normals", label: "angle between normals, degrees", low: 0, high: points.high_angle, map: maps.viridis, values: points.angles });
    if (points.fingers) {
      const colours = new Uint8Array(scene.finger_colours.flat()), count = scene.finger_colours.length;
      pointLooks.push({ name: "finger", low: -0.5, high: count - 0.5, map: space.texture(colours, true), values: Float32Array.from(points.fingers, (f) => (f === 255 ? NaN : f % count)) });
    }
  }

  // --- layers --------------------------------------------------------------------------------------------
  let body = bodies[0], look = looks[0], pointLook = pointLooks[0] || null;
  const choice = (parent, kind, group, name, checked, act, swatch) => {
    const label = document.createElement("label");
    const input = document.createElement("input");
    input.type = kind;
    input.name = kind === "radio" ? group : name;
    input.value = name;
    input.checked = checked;
    input.addEventListener("change", () => { act(input.checked); space.draw(); });
    label.append(input);
    if (swatch) {
      const mark = document.createElement("i");
      mark.className = "swatch";
      if (swatch === "edge") mark.classList.add("edge");
      else mark.style.background = swatch;
      label.append(mark);
    }
    label.append(name);
    by(parent).append(label);
    return input;
  };
  const rgb = (colour) => (colour ? `rgb(${colour.map((x) => Math.round(255 * x)).join(" ")})` : "edge");
  // Lines of the surface are of no use over another body.
  const show = (one) => {
    body = one;
    for (const layer of lines) layer.input.disabled = layer.of_surface && body !== null && body !== bodies[0];
  };
  bodies.forEach((one) => choice("bodies", "radio", "body", one.name, one === body, () => show(one)));
  choice("bodies", "radio", "body", "nothing", false, () => show(null));
  looks.forEach((one) => choice("colours", "radio", "surface", one.name, one === look, () => { look = one; if (one.field) bodies[0].made.paint(one.field.values); }));
  if (points) {
    pointLooks.forEach((one) => choice("points", "radio", "points", one.name, one === pointLook, () => { pointLook = one; points.made.paint(one.values); }));
    choice("points", "radio", "points", "hidden", false, () => { pointLook = null; });
  } else by("points").remove();
  for (const layer of lines) layer.input = choice("overlays", "checkbox", "overlay", layer.name, layer.on, (on) => { layer.on = on; }, rgb(layer.colour));

  // What the colours mean: of the surface, of the points, or of both.
  let told = null;
  const legend = () => {
    const shown = [];
    if (body === bodies[0] && look.field) shown.push({ ...look.field, label: look.field.name, map: maps[look.field.map] });
    if (pointLook && pointLook.label) shown.push(pointLook);
    const key = shown.map((one) => one.label).join();
    if (told === key) return;
    told = key;
    by("legend").hidden = !shown.length;
    const part = (kind, text) => { const made = document.createElement("span"); made.className = kind; made.append(text); return made; };
    by("legend").replaceChildren(...shown.flatMap(({ label, low, high, map: { colours } }) => {
      const bar = part("bar", ""), ends = part("ends", "");
      bar.style.background = ramp(colours);
      ends.append(part("", short(low)), part("", short(high)));
      return [part("", label), bar, ends];
    }));
  };
  const paint = (frame) => {
    if (body === bodies[0]) frame.surface(body.made, look.field ? { mode: 1, low: look.field.low, high: look.field.high, map: maps[look.field.map] } : { mode: look.mode });
    else if (body) {
      frame.surface(body.made, { clay: frame.css("--mesh") });
      frame.lines(body.edges, body);
    }
    if (pointLook) frame.points(points.made, { radius: points.radius, low: pointLook.low, high: pointLook.high, map: pointLook.map });
    for (const layer of lines) if (layer.on && !(layer.of_surface && body && body !== bodies[0])) frame.lines(layer.made, { width: layer.width, opacity: layer.opacity, colour: layer.colour || undefined });
    legend();
  };

  // --- picking -------------------------------------------------------------------------------------------
  const place = (p) => [0, 1, 2].map((i) => short(p[i] + scene.centre[i])).join(", ");
  // The nearest triangle of a mesh that a ray meets.
  const meet = ({ positions, triangles }, eye, ray) => {
    let hit = null;
    for (let t = 0; t < triangles.length; t += 3) {
      const ids = triangles.subarray(t, t + 3);
      const [a, b, c] = [0, 1, 2].map((k) => positions.subarray(3 * ids[k], 3 * ids[k] + 3));
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
      if (depth > 0 && (!hit || depth < hit.depth)) hit = { depth, triangle: t / 3, corners: ids, shares: [1 - m - n, m, n] };
    }
    return hit;
  };
  const pick = (x, y) => {
    const { eye, ray, right, up, back, tall, sx, sy } = space.sight(x, y);
    const hit = body && meet(body.mesh, eye, ray);
    let near = null;
    if (pointLook) for (let i = 0; i < points.distances.length; i++) {
      const p = [0, 1, 2].map((k) => points.positions[3 * i + k] - eye[k]);
      const depth = -dot(p, back);
      const away = Math.hypot(dot(p, right) / depth - sx, dot(p, up) / depth - sy) / tall * canvas.clientHeight / 2;
      if (away < points.radius + 4 && (!hit || depth < hit.depth + 0.03 * scene.radius) && (!near || away < near.away)) near = { away, i };
    }
    const out = by("picked");
    out.hidden = !(near || hit);
    if (near) {
      const i = near.i, at = points.positions.subarray(3 * i, 3 * i + 3);
      const says = [`Point ${i + 1} at ${place(at)}${unit}`, `distance to the surface ${short(points.distances[i])}${unit}`, `angle between normals ${short(points.angles[i])}°`];
      if (points.fingers && points.fingers[i] !== 255) says.push(`touched by finger ${points.fingers[i] + 1}`);
      out.textContent = says.join("\n");
    } else if (hit) {
      const { mesh } = body;
      const mix = (f) => hit.shares.reduce((sum, share, k) => sum + share * f(hit.corners[k]), 0);
      const at = [0, 1, 2].map((i) => mix((v) => mesh.positions[3 * v + i]));
      const scale = mesh.normals instanceof Int16Array ? 32767 : 1;
      const normal = [0, 1, 2].map((i) => mix((v) => mesh.normals[3 * v + i] / scale));
      const what = mesh.patches ? `Patch ${mesh.patches[hit.triangle]}` : `Triangle ${hit.triangle} of the ${body.name}`;
      const values = mesh.patches ? fields.map((field) => `${field.name}: ${short(mix((v) => field.values[v]))}`) : [];
      out.textContent = [`${what} at ${place(at)}${unit}`, `normal ${normal.map((c) => c.toFixed(3)).join(", ")}`, ...values].join("\n");
    }
  };
  // For whoever drives the page by a program: where a point is seen.
  canvas.dataset.points = points ? points.distances.length : 0;
  canvas.seen = (i) => space.project(points.positions.subarray(3 * i, 3 * i + 3));
  space.paint();
})();
