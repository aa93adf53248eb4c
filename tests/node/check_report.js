// Opens a report page as a person does: clicks through all layers, picks a point and a place, turns it by keyboard, looks
// at it in the dark, on a phone and on paper. Prints what it saw as JSON.
//
//   check_report.js PAGE.html [FOLDER FOR SCREENSHOTS]
const assert = require("assert");
const path = require("path");
const { check } = require("./browser.js");

// sRGB (IEC 61966-2-1), from and to 0 to 255.
const linear = (c) => (c <= 10.31475 ? c / 3294.6 : ((c / 255 + 0.055) / 1.055) ** 2.4);
const encoded = (x) => 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);

const [file, folder] = process.argv.slice(2);

check(async (page) => {
  const shot = (name, whole) => (folder ? page.screenshot(path.join(folder, `${name}.png`), whole) : null);
  await page.size(1280, 900);
  await page.open("file://" + path.resolve(file));
  assert.equal(await page.evaluate("document.getElementById('poster')"), null, "drawn by WebGL, not the still picture");
  await page.frame();
  const seen = { layers: [], title: await page.evaluate("document.title") };
  await shot("light", true);

  // Charts, each with its numbers in words for those who do not see them.
  seen.charts = await page.evaluate("[...document.querySelectorAll('.charts svg')].map((chart) => chart.getAttribute('aria-label'))");

  // Every layer changes the picture, and back.
  const inputs = await page.evaluate("[...document.querySelectorAll('#layers input')].map((i) => ({ kind: i.type, group: i.name, name: i.value, on: i.checked }))");
  for (const group of ["body", "surface", "points"]) {
    const all = inputs.filter((i) => i.group === group);
    const first = all.find((i) => i.on);
    const sums = new Set();
    for (const input of [...all.filter((i) => !i.on), first]) {
      await page.clickOn(`#layers input[name="${group}"][value="${input.name}"]`);
      await page.frame();
      const { count, sum } = await page.drawn();
      assert(count > 1000 || input.name === "nothing", `${input.name}: ${count} pixels`);
      sums.add(sum);
      seen.layers.push(input.name);
      if (input !== first) await shot(`${group}-${input.name.replace(/[^a-z0-9]+/gi, "-")}`);
    }
    assert.equal(sums.size, all.length, `every choice of ${group} looks different`);
    if (group === "body") assert.equal(await page.evaluate("document.querySelectorAll('#layers :disabled').length"), 0, "all layers can be used with the surface");
  }
  for (const input of inputs.filter((i) => i.kind === "checkbox")) {
    const before = await page.drawn();
    await page.clickOn(`#layers input[value="${input.name}"]`);
    await page.frame();
    assert.notEqual((await page.drawn()).sum, before.sum, `${input.name} changes the picture`);
    seen.layers.push(input.name);
    if (!input.on) await shot(`layer-${input.name.replace(/[^a-z0-9]+/gi, "-")}`);
    await page.clickOn(`#layers input[value="${input.name}"]`);
    await page.frame();
    assert.equal((await page.drawn()).sum, before.sum, `${input.name} can be undone`);
  }

  // A point says its values, a place its own.
  const centred = () => page.evaluate("(() => { const v = document.getElementById('view'); v.scrollIntoView({ block: 'center' }); const r = v.getBoundingClientRect(); return [r.x, r.y, r.width, r.height]; })()");
  let rect = await centred();
  const count = await page.evaluate("+document.getElementById('view').dataset.points");
  const picked = () => page.evaluate("document.getElementById('picked').hidden ? '' : document.getElementById('picked').textContent");
  if (count) {
    // The nearest point is in front of the surface.
    const at = await page.evaluate(`(() => { const v = document.getElementById('view'); let best = null; for (let i = 0; i < ${count}; i++) { const p = v.seen(i); if (!best || p.depth < best.depth) best = { ...p, i }; } return best; })()`);
    await page.click(rect[0] + at.x, rect[1] + at.y);
    seen.point = await picked();
    assert.match(seen.point, /^Point \d+ at .*\ndistance to the surface [\d.e-]+.*\nangle between normals [\d.e-]+°/);
  }
  await page.clickOn("#layers input[name=points][value=hidden]").catch(() => {});
  const places = [[0.5, 0.35], [0.35, 0.5], [0.5, 0.5], [0.65, 0.5], [0.5, 0.65]];
  rect = await centred();
  for (const [x, y] of places) {
    await page.click(rect[0] + x * rect[2], rect[1] + y * rect[3]);
    if ((seen.place = await picked()).startsWith("Patch")) break;
  }
  assert.match(seen.place, /^Patch \d+ at .*\nnormal [-\d., ]+\n[\s\S]*mean curvature/);
  await shot("picked");

  // Colours say what the legend says: at places of the surface, the picked value's colour on the map, at most darkened
  // by the shade, the same for red, green and blue.
  const fields = await page.evaluate(`(() => { const scene = JSON.parse(document.getElementById("scene").textContent); return scene.fields.map(({ name, low, high, map }) => ({ name, low, high, colours: [...atob(scene.maps[map])].map((c) => c.charCodeAt(0)) })); })()`);
  const ticked = inputs.filter((i) => i.kind === "checkbox" && i.on);
  const tickAll = async () => { for (const { name } of ticked) await page.clickOn(`#layers input[value="${name}"]`); };
  await tickAll();
  seen.colours = 0;
  for (const { name, low, high, colours } of fields) {
    await page.clickOn(`#layers input[name=surface][value="${name}"]`);
    rect = await centred();
    await page.frame();
    for (const [x, y] of places.map(([x, y]) => [Math.round(x * rect[2]), Math.round(y * rect[3])])) {
      await page.click(rect[0] + x, rect[1] + y);
      const said = (await picked()).split("\n").find((line) => line.startsWith(`${name}: `));
      const value = said ? parseFloat(said.slice(name.length + 2)) : NaN;
      if (Number.isNaN(value)) continue;
      const pixel = await page.pixel(x, y), sum = (rgb) => rgb.reduce((all, c) => all + linear(c), 0);
      const step = Math.max(0, Math.min(255, Math.floor((value - low) / (high - low) * 256)));
      // A click and a pixel's middle may lie half a pixel apart: colours 2 % of the map away are taken too.
      const off = Array.from({ length: 9 }, (_, i) => 3 * Math.max(0, Math.min(255, step + i - 4))).map((at) => {
        const meant = colours.slice(at, at + 3), shade = sum(pixel) / sum(meant);
        return shade > 0.7 && shade < 1.03 ? Math.max(...pixel.map((c, i) => Math.abs(c - encoded(shade * linear(meant[i]))))) : Infinity;
      });
      assert(Math.min(...off) < 5, `${name} ${value}: ${pixel} for ${colours.slice(3 * step, 3 * step + 3)}`);
      seen.colours++;
    }
  }
  assert(seen.colours >= fields.length, "places of every field");
  await page.clickOn("#layers input[name=surface]");
  await tickAll();

  // Keyboard.
  await page.frame();
  const before = await page.drawn();
  await page.evaluate("document.getElementById('view').focus()");
  for (const key of ["ArrowLeft", "ArrowUp", "+"]) await page.key(key);
  await page.frame();
  assert.notEqual((await page.drawn()).sum, before.sum, "keys turn it");
  await page.key("0");
  await page.frame();
  assert.equal((await page.drawn()).sum, before.sum, "0 brings it back");

  // Dark, phone, paper: nothing sticks out sideways.
  const fits = () => page.evaluate("document.documentElement.scrollWidth <= innerWidth + 1");
  await page.size(1280, 900, { dark: true });
  await page.frame();
  await shot("dark", true);
  assert(await fits());
  await page.clickOn("#theme");
  assert.equal(await page.evaluate("document.documentElement.dataset.theme"), "light");
  await page.evaluate("delete document.documentElement.dataset.theme");
  await page.size(390, 844, { phone: true });
  await page.frame();
  await shot("phone", true);
  assert(await fits(), "fits a phone");
  await page.size(794, 1123, { media: "print" });
  await page.frame();
  await shot("print", true);

  // Where there is no WebGL the still picture stays, and the rest of the page.
  await page.before("HTMLCanvasElement.prototype.getContext = () => null;");
  await page.open("file://" + path.resolve(file));
  assert.equal(await page.evaluate("document.getElementById('poster').complete && !document.querySelector('#layers input') && !document.querySelector('canvas')"), true);
  await shot("still");
  assert.deepEqual(page.asked.filter((url) => !url.startsWith("data:") && url !== "file://" + path.resolve(file)), [], "nothing else is fetched");
  assert.deepEqual(page.errors, []);
  return seen;
});
