// The live page: hand, contacts as they come, and the last surface that was fitted to them.
(() => {
  // Okabe and Ito's colours, which differ in every common form of colour blindness.
  const COLOURS = [[0, 114, 178], [230, 159, 0], [0, 158, 115], [204, 121, 167], [86, 180, 233], [213, 94, 0]];
  const HISTORY = 100;
  const canvas = by("view");
  const space = openSpace(canvas);
  themeButton(() => space && space.draw());
  if (!space) {
    canvas.remove();
    by("surface-says").textContent = "This browser shows no WebGL 2; the numbers are shown all the same.";
  }
  const map = space && space.colourMap(new Uint8Array(bytes(cividis))), sure = space && space.numbers(map);
  const palette = space && space.colourMap(new Uint8Array(COLOURS.flat()));
  const fingers = { low: 0, high: COLOURS.length, map: palette };
  if (space) by("legend-bar").style.background = ramp(map);

  // --- layers --------------------------------------------------------------------------------------------
  const on = {};
  for (const name of ["surface", "openings", "contacts", "hand"]) {
    on[name] = true;
    tick("overlays", "checkbox", name, name, true, (is) => { on[name] = is; show(); });
  }
  const show = () => {
    if (!space) return;
    if (surface) [surface.made.visible, surface.borders.visible] = [on.surface, on.openings];
    for (const { made } of blocks) made.visible = on.contacts;
    for (const { made, tip } of bones.values()) made.visible = tip.visible = on.hand;
    space.draw();
  };

  // --- contacts: kept in blocks, so that new ones never move the old ---------------------------------------
  const BLOCK = 4096;
  let blocks = [], epoch = null, last = { fingers: [] }, surface = null;
  const bones = new Map(), box = space && new THREE.Box3();
  const takePoints = ({ epoch: now, from, data }) => {
    if (!space) return;
    if (now !== epoch || from === 0) {
      blocks.forEach((block) => space.remove(block.made));
      [blocks, epoch] = [[], now];
      box.makeEmpty();
    }
    const view = new DataView(bytes(data)), fresh = new Set();
    for (let at = 0; at + 29 <= view.byteLength; at += 29) {
      let block = blocks.at(-1);
      if (!block || block.count === BLOCK) {
        block = { count: 0, positions: new Float32Array(3 * BLOCK), values: new Float32Array(BLOCK) };
        block.made = space.points(block.positions, 1.7);
        blocks.push(block);
      }
      const p = [0, 1, 2].map((i) => view.getFloat32(at + 4 * i, true));
      box.expandByPoint(new THREE.Vector3(...p));
      block.positions.set(p, 3 * block.count);
      block.values[block.count++] = view.getUint8(at + 28) % COLOURS.length;
      fresh.add(block);
    }
    for (const { made, positions, values, count } of fresh) {
      space.move(made, positions, count);
      space.paintPoints(made, values, fingers);
    }
    if (blocks.length) space.frame(box.getCenter(new THREE.Vector3()), Math.max(40, 0.62 * box.getSize(new THREE.Vector3()).length()));
  };
  const takeSurface = (said) => {
    if (said.number && space) {
      if (surface) [surface.made, surface.borders].forEach(space.remove);
      surface = { made: space.body(floats(said.positions), floats(said.normals), new Uint32Array(bytes(said.triangles)), sure), borders: space.lines(floats(said.borders), { width: 4, colour: [0.75, 0.1, 0.1] }) };
      space.paintBody(surface.made, floats(said.sigma), { low: said.low, high: Math.max(said.high, said.low + 1e-9) });
      by("legend").hidden = false;
      by("legend-low").textContent = short(said.low);
      by("legend-high").textContent = short(said.high);
    }
    const count = (n, one, many) => `${n === 0 ? "no" : n} ${n === 1 ? one : many}`;
    by("surface-says").textContent = `Surface ${said.number}: ${said.patches} patches through ${said.points} contacts, rms ${short(said.rms_mm)} mm; ` +
      `${count(said.pieces, "piece", "pieces")}, ${count(said.openings, "opening", "openings")}, ${count(said.handles, "handle", "handles")} (${said.seconds.toFixed(1)} s)`;
  };

  // --- the hand ------------------------------------------------------------------------------------------
  const takeHand = (all) => {
    if (space) all.forEach(({ chain_mm, connected, last }, k) => {
      if (chain_mm.length < 2) return;
      const ends = new Float32Array(chain_mm.slice(1).flatMap((to, i) => [...chain_mm[i], ...to]));
      if (!bones.has(k)) bones.set(k, { made: space.lines(ends, { width: 6, opacity: 0.85, colour: [0, 0, 0] }), tip: space.points(new Float32Array(6), 7) });
      const { made, tip } = bones.get(k), touches = last && last.valid;
      made.material.color.copy(space.srgb(...(connected ? COLOURS[k % COLOURS.length].map((c) => c / 255) : [0.6, 0.6, 0.6])));
      space.move(made, ends);
      space.move(tip, [...chain_mm.at(-1), ...(touches ? last.at_mm : [0, 0, 0])], touches ? 2 : 1);
      space.paintPoints(tip, [k, k].map((finger) => finger % COLOURS.length), fingers);
    });
  };

  // --- the fingers' cards --------------------------------------------------------------------------------
  const cards = new Map();
  const card = (name, k) => {
    if (cards.has(name)) return cards.get(name);
    const box = create(by("fingers"), "div", "finger");
    box.style.setProperty("--mark", `rgb(${COLOURS[k % COLOURS.length]})`);
    const head = create(box, "h3", "", name), force = create(box, "div", "force");
    const made = { box, state: create(head, "span"), number: create(force, "strong"), graph: create(force, "canvas"), valid: create(box, "p"), why: create(box, "p", "why"), link: create(box, "p"), forces: [] };
    made.graph.setAttribute("aria-hidden", "true");
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
      const item = create(by("notes"), "li", weight);
      create(item, "time", "", `${at.toFixed(1)} s`);
      item.append(`${finger}: ${text}`);
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
  const stream = new EventSource("/events");
  const listen = (name, take) => stream.addEventListener(name, (event) => {
    take(JSON.parse(event.data));
    show();
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
