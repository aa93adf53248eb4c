// A headless Chromium driven through its DevTools pipe: no package, no port.
//
// PALPUS_TEST_BROWSER names another browser of that family. Drawing is by software, so it works without a screen.
const { spawn } = require("child_process");
const fs = require("fs");
const os = require("os");
const path = require("path");

const PATIENCE_MS = 120000;

function binary() {
  const named = process.env.PALPUS_TEST_BROWSER;
  if (named) return named;
  for (const folder of (process.env.PATH || "").split(":"))
    for (const name of ["chromium", "chromium-browser", "google-chrome"])
      if (fs.existsSync(path.join(folder, name))) return path.join(folder, name);
  throw new Error("no Chromium: run tests/setup");
}

async function launch() {
  const profile = fs.mkdtempSync(path.join(os.tmpdir(), "palpus-browser-"));
  const options = ["--headless", "--no-sandbox", "--disable-gpu-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage",
    "--hide-scrollbars", "--no-first-run", "--disable-background-networking", `--user-data-dir=${profile}`, "--remote-debugging-pipe", "about:blank"];
  const child = spawn(binary(), options, { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"] });
  const [to, from] = [child.stdio[3], child.stdio[4]];
  const waiting = new Map();
  const errors = [], asked = [];
  let number = 0, rest = "";
  const fail = (why) => { for (const { reject } of waiting.values()) reject(why); waiting.clear(); };
  child.on("exit", (code) => fail(new Error(`the browser has ended (${code})`)));
  child.on("error", fail);
  to.on("error", () => {});
  from.setEncoding("utf8");
  from.on("data", (text) => {
    const parts = (rest + text).split("\0");
    rest = parts.pop();
    for (const part of parts) {
      const said = JSON.parse(part);
      if (said.method === "Runtime.exceptionThrown") errors.push(said.params.exceptionDetails.exception?.description || said.params.exceptionDetails.text);
      if (said.method === "Network.requestWillBeSent") asked.push(said.params.request.url);
      if (said.method === "Log.entryAdded" && said.params.entry.level === "error") errors.push(said.params.entry.text);
      const call = waiting.get(said.id);
      if (!call) continue;
      waiting.delete(said.id);
      clearTimeout(call.timer);
      if (said.error) call.reject(new Error(`${call.method}: ${said.error.message}`));
      else call.resolve(said.result);
    }
  });
  const send = (method, params = {}, sessionId) => new Promise((resolve, reject) => {
    const id = ++number;
    const timer = setTimeout(() => { waiting.delete(id); reject(new Error(`${method}: no answer`)); }, PATIENCE_MS);
    waiting.set(id, { method, resolve, reject, timer });
    to.write(JSON.stringify({ id, method, params, sessionId }) + "\0");
  });

  const { targetId } = await send("Target.createTarget", { url: "about:blank" });
  const { sessionId } = await send("Target.attachToTarget", { targetId, flatten: true });
  const call = (method, params) => send(method, params, sessionId);
  await call("Page.enable");
  await call("Runtime.enable");
  await call("Log.enable");
  await call("Network.enable");
  const sleep = (ms) => new Promise((done) => setTimeout(done, ms));
  const page = {
    errors,
    // Addresses that were asked for, in order.
    asked,
    sleep,
    // Runs a script in every page that is opened from now on, before any of the page's own.
    before: (source) => call("Page.addScriptToEvaluateOnNewDocument", { source }),
    // Runs an expression in the page and returns its value.
    async evaluate(expression) {
      const { result, exceptionDetails } = await call("Runtime.evaluate", { expression, awaitPromise: true, returnByValue: true });
      if (exceptionDetails) throw new Error(`${expression}: ${exceptionDetails.exception?.description || exceptionDetails.text}`);
      return result.value;
    },
    async size(width, height, { dark = false, phone = false, media = "" } = {}) {
      await call("Emulation.setDeviceMetricsOverride", { width, height, deviceScaleFactor: phone ? 2 : 1, mobile: phone });
      await call("Emulation.setEmulatedMedia", { media, features: [{ name: "prefers-color-scheme", value: dark ? "dark" : "light" }] });
    },
    async open(url) {
      await call("Page.navigate", { url });
      await page.until("document.readyState === 'complete'");
    },
    // Waits until an expression is true in the page.
    async until(expression, what = expression) {
      const end = Date.now() + PATIENCE_MS;
      for (;;) {
        const value = await page.evaluate(expression).catch(() => false);
        if (value) return value;
        if (Date.now() > end) throw new Error(`never came true: ${what}`);
        await sleep(50);
      }
    },
    // Two frames later all that was asked for is drawn.
    frame: () => page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"),
    async click(x, y) {
      for (const type of ["mousePressed", "mouseReleased"]) await call("Input.dispatchMouseEvent", { type, x, y, button: "left", buttons: 1, clickCount: 1 });
    },
    async clickOn(selector) {
      const box = await page.evaluate(`(() => { const e = document.querySelector(${JSON.stringify(selector)}); e.scrollIntoView({ block: "center" }); const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()`);
      await page.click(...box);
    },
    async key(key) {
      for (const type of ["keyDown", "keyUp"]) await call("Input.dispatchKeyEvent", { type, key, code: key });
    },
    async screenshot(file, whole = false) {
      const { data } = await call("Page.captureScreenshot", { format: "png", captureBeyondViewport: whole });
      if (file) fs.writeFileSync(file, Buffer.from(data, "base64"));
      return Buffer.from(data, "base64");
    },
    // The colour of the view at a place of its own, red, green and blue.
    pixel: (x, y) => page.evaluate(`(() => {
      const view = document.getElementById("view"), gl = view.getContext("webgl2"), scale = view.width / view.clientWidth, p = new Uint8Array(4);
      gl.readPixels(Math.floor(${x} * scale), view.height - 1 - Math.floor(${y} * scale), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, p);
      return [...p.slice(0, 3)];
    })()`),
    // How many pixels of the view differ from the ground, and a number that changes with the picture.
    drawn: () => page.evaluate(`(() => {
      const view = document.getElementById("view"), gl = view.getContext("webgl2"), w = view.width, h = view.height, p = new Uint8Array(4 * w * h);
      gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, p);
      let count = 0, sum = 0;
      for (let i = 0; i < p.length; i += 4) {
        if (p[i] !== p[0] || p[i + 1] !== p[1] || p[i + 2] !== p[2]) count++;
        sum = (sum * 31 + p[i] * 7 + p[i + 1] * 3 + p[i + 2]) % 4294967291;
      }
      return { count, sum };
    })()`),
    async close() {
      const gone = new Promise((done) => { if (child.exitCode !== null) done(); else child.on("exit", done); });
      send("Browser.close").catch(() => {});
      const timer = setTimeout(() => child.kill("SIGKILL"), 5000);
      await gone;
      clearTimeout(timer);
      // Its helpers may still write for a moment.
      try { fs.rmSync(profile, { recursive: true, force: true, maxRetries: 10, retryDelay: 200 }); } catch { /* a temporary folder may stay */ }
    },
  };
  return page;
}

// Runs a check with a browser that is closed whatever comes of it.
function check(work) {
  launch().then(async (page) => {
    try {
      console.log(JSON.stringify(await work(page)));
    } finally {
      await page.close();
    }
  }).catch((error) => { console.error(error.stack || error); process.exitCode = 1; });
}

module.exports = { check };
