// The three-dimensional view of the report page.
(() => {
  const scene = JSON.parse(by("scene").textContent);
  const canvas = by("view");
  const unit = scene.unit ? " " + scene.unit : "";
  const space = openSpace(canvas, (x, y) => pick(x, y));
  themeButton(() => space && space.draw());
  if (!space) {
    canvas.remove();
    by("layers").querySelectorAll("fieldset").forEach((part) => part.remove());
    by("layers").querySelector(".hint").textContent = "This browser shows no WebGL 2, so here is a still picture.";
    return;
  }
  by("poster").remove();
  space.frame(new THREE.Vector3(), scene.radius);

  // --- what there is to draw -----------------------------------------------------------------------------
  const indices = (text) => new Uint32Array(bytes(text));
  const maps = Object.fromEntries(Object.entries(scene.maps).map(([name, text]) => [name, space.colourMap(new Uint8Array(bytes(text)))]));
  const fields = scene.fields.map((field) => ({ ...field, values: floats(field.values), map: maps[field.map] }));
  const smooth = scene.surface, patches = indices(smooth.patches);
  const looks = [{ name: "shape alone", material: space.clay("--clay") }, ...fields.map((field) => ({ name: field.name, material: space.numbers(field.map), field })), { name: "reflection lines", material: space.mirror }];
  const bodies = [{ name: "surface", made: space.body(floats(smooth.positions), new Int16Array(bytes(smooth.normals)), indices(smooth.triangles), looks[0].material) }];
  for (const { name, positions, triangles } of scene.meshes) {
    const made = space.body(floats(positions), null, indices(triangles), space.clay("--mesh", true));
    const edges = new THREE.WireframeGeometry(made.geometry).getAttribute("position").array;
    const thin = Math.max(0.3, Math.min(1, Math.sqrt(3000 * 6 / edges.length)));
    bodies.push({ name, made, edges: space.lines(edges, { width: 1.4 * thin, opacity: Math.max(0.35, 0.85 * thin) }) });
  }
  const lines = scene.lines.map((layer) => ({ ...layer, made: space.lines(floats(layer.segments), layer) }));
  let points = null;
  const pointLooks = [];
  if (scene.points) {
    points = { ...scene.points, distances: floats(scene.points.distances), angles: floats(scene.points.angles), fingers: scene.points.fingers && new Uint8Array(bytes(scene.points.fingers)) };
    points.made = space.points(floats(points.positions), points.radius);
    pointLooks.push({ name: "distance to the surface", label: "distance of the points" + (scene.unit ? ", " + scene.unit : ""), low: 0, high: points.high, map: maps.viridis, values: points.distances });
    pointLooks.push({ name: "angle between normals", label: "angle between normals, degrees", low: 0, high: points.high_angle, map: maps.viridis, values: points.angles });
    if (points.fingers) {
      const map = space.colourMap(new Uint8Array(scene.finger_colours.flat()));
      pointLooks.push({ name: "finger", low: 0, high: scene.finger_colours.length, map, values: Float32Array.from(points.fingers, (f) => (f === 255 ? NaN : f % scene.finger_colours.length)) });
    }
  }

  // --- layers --------------------------------------------------------------------------------------------
  let body = bodies[0], look = looks[0], pointLook = pointLooks[0] || null;
  const legend = () => {
    const shown = [];
    if (body === bodies[0] && look.field) shown.push({ ...look.field, label: look.name });
    if (pointLook && pointLook.label) shown.push(pointLook);
    by("legend").hidden = !shown.length;
    by("legend").replaceChildren();
    for (const { label, low, high, map } of shown) {
      create(by("legend"), "span", "", label);
      create(by("legend"), "span", "bar").style.background = ramp(map);
      const ends = create(by("legend"), "span", "ends");
      [low, high].forEach((x) => create(ends, "span", "", short(x)));
    }
  };
  const show = () => {
    // Lines of the surface are of no use over another body.
    const other = body && body !== bodies[0];
    for (const one of bodies) {
      one.made.visible = one === body;
      if (one.edges) one.edges.visible = one === body;
    }
    for (const layer of lines) {
      layer.made.visible = layer.on && !(layer.of_surface && other);
      layer.input.disabled = layer.of_surface && other;
    }
    bodies[0].made.material = look.material;
    if (look.field) space.paintBody(bodies[0].made, look.field.values, look.field);
    if (points) points.made.visible = pointLook !== null;
    if (pointLook) space.paintPoints(points.made, pointLook.values, pointLook);
    legend();
    by("picked").hidden = true;
    space.draw();
  };
  for (const one of [...bodies, null]) tick("bodies", "radio", "body", one ? one.name : "nothing", one === body, () => { body = one; show(); });
  for (const one of looks) tick("colours", "radio", "surface", one.name, one === look, () => { look = one; show(); });
  if (points) for (const one of [...pointLooks, null]) tick("points", "radio", "points", one ? one.name : "hidden", one === pointLook, () => { pointLook = one; show(); });
  else by("points").remove();
  for (const layer of lines) {
    layer.input = tick("overlays", "checkbox", "overlay", layer.name, layer.on, (on) => { layer.on = on; show(); });
    const swatch = document.createElement("span");
    swatch.className = layer.colour ? "swatch" : "swatch edge";
    if (layer.colour) swatch.style.background = `rgb(${layer.colour.map((x) => Math.round(255 * x)).join(" ")})`;
    layer.input.after(swatch);
  }

  // --- picking -------------------------------------------------------------------------------------------
  const triple = (v, say) => [v.x, v.y, v.z].map(say).join(", ");
  const place = (p) => [p.x, p.y, p.z].map((x, i) => short(x + scene.centre[i])).join(", ") + unit;
  const pick = (x, y) => {
    const { hit, dot } = space.under(x, y, body && body.made, pointLook && points.made);
    const says = [];
    if (dot) {
      const i = dot.index, at = new THREE.Vector3().fromBufferAttribute(points.made.geometry.getAttribute("position"), i);
      says.push(`Point ${i + 1} at ${place(at)}`, `distance to the surface ${short(points.distances[i])}${unit}`, `angle between normals ${short(points.angles[i])}°`);
      if (points.fingers && points.fingers[i] !== 255) says.push(`touched by finger ${points.fingers[i] + 1}`);
    } else if (hit) {
      const { faceIndex, face, barycoord } = hit, at = body.made.worldToLocal(hit.point.clone());
      const mix = (f) => f(face.a) * barycoord.x + f(face.b) * barycoord.y + f(face.c) * barycoord.z;
      if (body === bodies[0]) {
        const n = body.made.geometry.getAttribute("normal"), normal = new THREE.Vector3(mix((v) => n.getX(v)), mix((v) => n.getY(v)), mix((v) => n.getZ(v)));
        says.push(`Patch ${patches[faceIndex]} at ${place(at)}`, `normal ${triple(normal, (c) => c.toFixed(3))}`, ...fields.map((field) => `${field.name}: ${short(mix((v) => field.values[v]))}`));
      } else says.push(`Triangle ${faceIndex} of the ${body.name} at ${place(at)}`, `normal ${triple(face.normal, (c) => c.toFixed(3))}`);
    }
    by("picked").hidden = !says.length;
    by("picked").textContent = says.join("\n");
  };
  show();
  space.paint();
  // For whoever drives the page by a program: where a point is seen.
  canvas.dataset.points = points ? points.distances.length : 0;
  canvas.seen = (i) => space.seen(points.made.geometry.getAttribute("position").array.subarray(3 * i, 3 * i + 3));
})();
