// Opens the live page, waits until it shows contacts, fingers and a surface, and switches its layers. Prints what it saw.
//
//   check_live.js URL [SCREENSHOT.png]
const assert = require("assert");
const { check } = require("./browser.js");

const [url, file] = process.argv.slice(2);

check(async (page) => {
  await page.size(1280, 900);
  await page.open(url);
  await page.until("+document.body.dataset.points > 200", "contacts come");
  await page.until("+document.body.dataset.surface >= 1", "a surface is fitted");
  await page.until("[...document.querySelectorAll('.finger h3 span')].every((s) => /^[1-9]\\d* contacts/.test(s.textContent))", "rates are shown");
  await page.frame();
  if (file) await page.screenshot(file);
  assert((await page.drawn()).count > 1000);
  for (const name of ["surface", "openings", "contacts", "hand"]) {
    await page.clickOn(`#layers input[name="${name}"]`);
    await page.frame();
  }
  // The hand comes anew with each state, so what is left is the ground alone once all layers are off.
  assert.equal((await page.drawn()).count, 0, "all layers can be switched off");
  const seen = await page.evaluate("({ status: document.getElementById('status').textContent, surface: document.getElementById('surface-says').textContent, fingers: [...document.querySelectorAll('.finger h3')].map((h) => h.firstChild.textContent) })");
  assert.deepEqual(page.asked.filter((address) => !address.startsWith(url)), [], "nothing is fetched from elsewhere");
  assert.deepEqual(page.errors, []);
  return seen;
});
