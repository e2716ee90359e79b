// The control page in Debian's chromium, against `unlit serve --studio`: the very drivers, a simulated world.
// Screenshots go to UNLIT_SCREENSHOTS or a temporary folder, whose name is printed.
//
// The program is UNLIT_BIN, or target/debug/unlit (`cargo build` makes it).

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, rmSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { after, before, test } from "node:test";
import { fileURLToPath } from "node:url";

const root = join(dirname(fileURLToPath(import.meta.url)), "../..");
const { chromium } = createRequire(join(root, "web/package.json"))("playwright-core");

const program = process.env.UNLIT_BIN ?? join(root, "target/debug/unlit");
const chromiumPath = process.env.CHROMIUM ?? "/usr/bin/chromium";
const shots = process.env.UNLIT_SCREENSHOTS ?? mkdtempSync(join(tmpdir(), "unlit-page-"));
const PATIENCE = 60_000;

let sessions, daemon, url, browser;

/** Starts the daemon and resolves with its address once it says that it listens. */
function start(...options) {
  assert.ok(existsSync(program), `${program} is not there; run: cargo build`);
  const child = spawn(program, ["serve", "--listen", "127.0.0.1:0", "--sessions", sessions, ...options], {
    stdio: ["ignore", "pipe", "inherit"],
  });
  const address = new Promise((resolve, reject) => {
    let said = "";
    const timer = setTimeout(() => reject(new Error(`it did not listen; it said: ${said}`)), PATIENCE);
    child.stdout.on("data", (bytes) => {
      said += bytes;
      const found = said.match(/http:\/\/\S+/);
      if (found) {
        clearTimeout(timer);
        resolve(found[0]);
      }
    });
    child.on("exit", (code) => reject(new Error(`it ended with ${code}; it said: ${said}`)));
  });
  return { child, address };
}

function stop({ child }) {
  return new Promise((resolve) => {
    child.removeAllListeners("exit");
    child.on("exit", (code) => resolve(code));
    child.kill("SIGTERM");
  });
}

async function open(width, height) {
  const page = await browser.newPage({ viewport: { width, height } });
  page.setDefaultTimeout(PATIENCE);
  const complaints = [];
  page.on("pageerror", (error) => complaints.push(error.message));
  page.on("console", (message) => message.type() === "error" && complaints.push(message.text()));
  await page.goto(url);
  return { page, complaints };
}

const shot = (page, name) => page.screenshot({ path: join(shots, `${name}.png`), fullPage: true });

before(async () => {
  mkdirSync(shots, { recursive: true });
  sessions = mkdtempSync(join(tmpdir(), "unlit-sessions-"));
  daemon = start("--studio");
  url = await daemon.address;
  browser = await chromium.launch({ executablePath: chromiumPath, args: ["--no-sandbox"] });
  console.log(`screenshots: ${shots}`);
});

after(async () => {
  await browser?.close();
  if (daemon) assert.equal(await stop(daemon), 0, "the daemon did not end cleanly");
  if (sessions) rmSync(sessions, { recursive: true });
});

test("the space bar takes a pair, which is listed with thumbnails and verdict", async () => {
  const { page, complaints } = await open(1280, 900);
  await page.getByText("Simulated studio").waitFor();
  await page.getByText("stop 1 of").waitFor();
  await page.locator(".devices .ready").nth(1).waitFor();
  await shot(page, "ready-1280");

  await page.keyboard.press("Space");
  await page.locator(".steps").waitFor();
  await shot(page, "taking-1280");
  const card = page.locator('[data-pair="1"]');
  await card.waitFor();
  await card.getByText("Accepted").waitFor();
  await page.waitForFunction(() => {
    const images = [...document.querySelectorAll('[data-pair="1"] img')];
    return images.length === 2 && images.every((image) => image.complete && image.naturalWidth > 100);
  });
  await page.getByText("stop 2 of").waitFor();
  await shot(page, "pair-1280");
  assert.deepEqual(complaints, []);
  await page.close();
});

test("the button takes a pair, and a second page sees it, on a telephone too", async () => {
  const first = await open(1280, 900);
  const second = await open(390, 844);
  await first.page.getByRole("button", { name: "Take pair" }).click();
  await second.page.locator('[data-pair="2"]').getByText("Accepted").waitFor();
  const wider = await second.page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
  assert.ok(wider <= 0, `the page is ${wider} px wider than the telephone`);
  await shot(second.page, "pair-390");
  assert.deepEqual([...first.complaints, ...second.complaints], []);
  await first.page.close();
  await second.page.close();
});

test("typing a space into the name of a session takes no pair", async () => {
  const { page, complaints } = await open(1280, 900);
  await page.locator('[data-pair="2"]').waitFor();
  await page.locator(".session summary").click();
  await page.getByLabel("New session").pressSequentially("two words");
  assert.equal(await page.getByLabel("New session").inputValue(), "two words");
  await shot(page, "session-1280");
  await page.getByRole("button", { name: "Create" }).click();
  await page.locator(".session summary").getByText("two words").waitFor();
  await page.getByText("No pairs yet.").first().waitFor();
  const jobs = await page.evaluate(() => fetch("/api/v1/jobs").then((answer) => answer.json()));
  assert.equal(jobs.filter((job) => job.kind === "pair").length, 2);
  assert.deepEqual(complaints, []);
  await page.close();
});

test("a lost daemon is told in words", async () => {
  const { page } = await open(1280, 900);
  await page.locator(".devices .ready").first().waitFor();
  assert.equal(await stop(daemon), 0);
  daemon = undefined;
  await page.getByText("No connection").waitFor();
  await shot(page, "lost-1280");
  await page.close();
});

test("without devices the page says what is missing", async () => {
  const bare = start("--flash", "none", "--camera", "ptpip:127.0.0.1:9:9");
  url = await bare.address;
  const { page } = await open(390, 844);
  await page.locator(".devices .missing").nth(1).getByText("no flash controller found").waitFor();
  await shot(page, "bare-390");
  await page.close();
  assert.equal(await stop(bare), 0);
});
