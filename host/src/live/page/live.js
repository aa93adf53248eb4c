// The live page: hand, contacts as they come, and the last surface that was fitted to them.
(() => {
  // Okabe and Ito's colours, which differ in every common form of colour blindness.
  const COLOURS = [[0, 114, 178], [230, 159, 0], [0, 158, 115], [204, 121, 167], [86, 180, 233], [213, 94, 0]];
  const HISTORY = 100;
  const canvas = by("view");
  const space = openSpace(canvas, { paint: (frame) => paint(frame) });
  themeButton(() => space && space.draw());
  if (!space) {
    canvas.remove();
    by("surface-says").textContent = "This browser shows no WebGL 2; the numbers are shown all the same.";
  }
  const map = space && space.texture(new Uint8Array(bytes(cividis)));
  const palette = space && space.texture(new Uint8Array(COLOURS.flat()), true);

  // --- layers --------------------------------------------------------------------------------------------
  const on = {};
  const layer = (name) => {
    on[name] = true;
    const label = document.createElement("label"), input = document.createElement("input");
    input.type = "checkbox";
    input.name = name;
    input.checked = true;
    input.addEventListener("change", () => { on[name] = input.checked; space && space.draw(); });
    label.append(input, name);
    by("overlays").append(label);
  };
  ["surface", "openings", "contacts", "hand"].forEach(layer);

  // --- contacts: kept in blocks, so that new ones never move the old ---------------------------------------
  const BLOCK = 4096;
  let blocks = [], epoch = null, last = { fingers: [] }, surface = null, box = null;
  const grow = (p) => {
    if (!box) box = { low: [...p], high: [...p] };
    for (let i = 0; i < 3; i++) { box.low[i] = Math.min(box.low[i], p[i]); box.high[i] = Math.max(box.high[i], p[i]); }
  };
  const frameAll = () => {
    if (!box || !space) return;
    space.home.centre = [0, 1, 2].map((i) => (box.low[i] + box.high[i]) / 2);
    space.home.radius = Math.max(40, Math.hypot(...[0, 1, 2].map((i) => box.high[i] - box.low[i])) * 0.62);
  };
  const takePoints = ({ epoch: now, from, data }) => {
    if (now !== epoch || from === 0) {
      blocks.forEach((block) => block.made && block.made.free());
      [blocks, epoch, box] = [[], now, null];
    }
    const view = new DataView(bytes(data));
    for (let at = 0; at + 29 <= view.byteLength; at += 29) {
      let block = blocks.at(-1);
      if (!block || block.count === BLOCK) blocks.push(block = { count: 0, positions: new Float32Array(3 * BLOCK), values: new Float32Array(BLOCK), made: null });
      const p = [0, 1, 2].map((i) => view.getFloat32(at + 4 * i, true));
      grow(p);
      block.positions.set(p, 3 * block.count);
      block.values[block.count++] = view.getUint8(at + 28) % COLOURS.length;
      block.stale = true;
    }
    frameAll();
  };
  const takeSurface = (said) => {
    if (said.number && space) {
      if (surface) [surface.made, surface.borders].forEach((part) => part.free());
      const triangles = new Uint32Array(bytes(said.triangles));
      surface = { ...said, made: space.surface(floats(said.positions), floats(said.normals), triangles, floats(said.sigma)), borders: space.lines(floats(said.borders)) };
      by("legend").hidden = false;
      by("legend-low").textContent = short(said.low);
      by("legend-high").textContent = short(said.high);
    }
    const count = (n, one, many) => `${n === 0 ? "no" : n} ${n === 1 ? one : many}`;
    by("surface-says").textContent = `Surface ${said.number}: ${said.patches} patches through ${said.points} contacts, rms ${short(said.rms_mm)} mm; ` +
      `${count(said.pieces, "piece", "pieces")}, ${count(said.openings, "opening", "openings")}, ${count(said.handles, "handle", "handles")} (${said.seconds.toFixed(1)} s)`;
  };

  // --- the hand ------------------------------------------------------------------------------------------
  let bones = null;
  const takeHand = (fingers) => {
    if (!space) return;
    if (bones) bones.forEach((bone) => bone.made.free());
    bones = fingers.map((finger, k) => [finger, k]).filter(([{ chain_mm }]) => chain_mm.length > 1).map(([{ chain_mm, connected, last }, k]) => {
      const ends = [];
      for (let i = 0; i + 1 < chain_mm.length; i++) ends.push(...chain_mm[i], ...chain_mm[i + 1]);
      const at = [...chain_mm.at(-1)], values = [k % COLOURS.length];
      if (last && last.valid) { at.push(...last.at_mm); values.push(k % COLOURS.length); }
      return { made: space.lines(new Float32Array(ends)), tip: space.points(new Float32Array(at), new Float32Array(values)), colour: connected ? COLOURS[k % COLOURS.length].map((c) => c / 255) : [0.6, 0.6, 0.6] };
    });
  };
  const paint = (frame) => {
    if (surface && on.surface) frame.surface(surface.made, { mode: 1, low: surface.low, high: Math.max(surface.high, surface.low + 1e-9), map });
    if (surface && on.openings) frame.lines(surface.borders, { width: 4, colour: [0.75, 0.1, 0.1] });
    if (on.contacts) for (const block of blocks) {
      if (block.stale) {
        if (block.made) block.made.free();
        block.made = space.points(block.positions.subarray(0, 3 * block.count), block.values.subarray(0, block.count));
        block.stale = false;
      }
      frame.points(block.made, { radius: 1.7, low: -0.5, high: COLOURS.length - 0.5, map: palette });
    }
    if (on.hand && bones) for (const bone of bones) {
      frame.lines(bone.made, { width: 6, colour: bone.colour, opacity: 0.85 });
      frame.points(bone.tip, { radius: 7, low: -0.5, high: COLOURS.length - 0.5, map: palette });
    }
  };

  // --- the fingers' cards --------------------------------------------------------------------------------
  const cards = new Map();
  const card = (name, k) => {
    if (cards.has(name)) return cards.get(name);
    const box = document.createElement("div");
    box.className = "finger";
    box.style.setProperty("--mark", `rgb(${COLOURS[k % COLOURS.length]})`);
    const part = (parent, tag, kind) => { const made = document.createElement(tag); if (kind) made.className = kind; parent.append(made); return made; };
    const head = part(box, "h3");
    head.append(name);
    const state = part(head, "span"), force = part(box, "div", "force");
    const made = { box, state, number: part(force, "strong"), graph: part(force, "canvas"), valid: part(box, "p"), why: part(box, "p", "why"), link: part(box, "p"), forces: [] };
    made.graph.setAttribute("aria-hidden", "true");
    by("fingers").append(box);
    cards.set(name, made);
    return made;
  };
  const graph = ({ graph: canvas, forces }) => {
    const scale = devicePixelRatio || 1, width = canvas.width = Math.round(canvas.clientWidth * scale), height = canvas.height = Math.round(canvas.clientHeight * scale);
    const pen = canvas.getContext("2d"), style = getComputedStyle(document.documentElement), most = Math.max(3, ...forces.map(([n]) => n));
    forces.forEach(([newtons, valid], i) => {
      pen.fillStyle = style.getPropertyValue(valid ? "--bar" : "--line");
      const tall = Math.max(1, newtons / most * height);
      pen.fillRect((HISTORY - forces.length + i) * width / HISTORY, height - tall, Math.max(1, width / HISTORY - 0.5), tall);
    });
  };
  const takeFinger = (finger, k) => {
    const c = card(finger.name, k), touch = finger.last;
    c.box.classList.toggle("lost", !finger.connected);
    c.state.textContent = finger.connected ? `${finger.per_s.toFixed(0)} contacts/s` : "searching for its board";
    const newtons = finger.connected && touch ? touch.force_n : 0, valid = Boolean(finger.connected && touch && touch.valid);
    c.number.textContent = `${newtons.toFixed(2)} N`;
    c.forces.push([newtons, valid]);
    if (c.forces.length > HISTORY) c.forces.shift();
    graph(c);
    c.valid.textContent = `${finger.valid} valid of ${finger.contacts}${finger.valid_share === null ? "" : `, ${(100 * finger.valid_share).toFixed(0)} % now`}${valid ? `, ±${short(touch.sigma_mm)}\u00a0mm` : ""}`;
    c.why.textContent = touch && !touch.valid ? `not valid: ${touch.reasons.join(", ")}` : "touching";
    const trouble = finger.lost + finger.bad + finger.reconnects + finger.reboots;
    c.link.classList.toggle("worse", trouble > 0);
    c.link.textContent = `${finger.lost} lost, ${finger.bad} damaged, ${finger.reconnects} reconnects, ${finger.reboots} restarts; clock ±${(finger.clock_bound_us / 1000).toFixed(2)} ms`;
  };
  const takeNotes = (notes) => {
    for (const { at, finger, weight, text } of notes) {
      const item = document.createElement("li"), time = document.createElement("time");
      time.textContent = `${at.toFixed(1)} s`;
      item.className = weight;
      item.append(time, `${finger}: ${text}`);
      by("notes").prepend(item);
      while (by("notes").children.length > 60) by("notes").lastChild.remove();
    }
  };
  let ended = false;
  const takeState = (state) => {
    last = state;
    const figures = `${state.seconds.toFixed(1)} s · ${state.points} points · ${(state.bytes / 1e6).toFixed(1)} MB safe`;
    ended = Boolean(state.ended);
    by("status").textContent = ended ? `Ended (${state.ended}) · ${figures}` : figures;
    state.fingers.forEach(takeFinger);
    takeHand(state.fingers);
    takeNotes(state.notes);
    if (state.no_surface) by("surface-says").textContent = `No new surface: ${state.no_surface}`;
    document.body.dataset.points = state.points;
  };

  // --- the stream ----------------------------------------------------------------------------------------
  const colours = new Uint8Array(bytes(cividis));
  by("legend-bar").style.background = ramp(colours);
  const stream = new EventSource("/events");
  const listen = (name, take) => stream.addEventListener(name, (event) => {
    take(JSON.parse(event.data));
    if (space) space.draw();
  });
  listen("state", takeState);
  listen("points", takePoints);
  listen("surface", (said) => { takeSurface(said); document.body.dataset.surface = said.number; });
  stream.addEventListener("open", () => by("notes").replaceChildren());
  stream.addEventListener("error", () => {
    if (ended) stream.close();
    else by("status").textContent = `Connection lost; trying again. Last seen: ${last.seconds === undefined ? "nothing" : `${last.seconds.toFixed(1)} s, ${last.points} points`}`;
  });
})();
