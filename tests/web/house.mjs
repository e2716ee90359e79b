// A daemon of its own with simulated devices, and Debian's chromium to look at its page.
//
// The program is UNLIT_BIN, or target/debug/unlit (`cargo build` makes it). Screenshots go to UNLIT_SCREENSHOTS or
// a temporary folder, whose name is printed.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, rmSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const root = join(dirname(fileURLToPath(import.meta.url)), "../..");
const { chromium } = createRequire(join(root, "web/package.json"))("playwright-core");

const program = process.env.UNLIT_BIN ?? join(root, "target/debug/unlit");
const chromiumPath = process.env.CHROMIUM ?? "/usr/bin/chromium";
const shots = process.env.UNLIT_SCREENSHOTS ?? mkdtempSync(join(tmpdir(), "unlit-page-"));
export const PATIENCE = 60_000;

/** A daemon, a browser, and a folder of sessions that goes away at the end. */
export class House {
  static async open(...options) {
    const house = new House();
    mkdirSync(shots, { recursive: true });
    console.log(`screenshots: ${shots}`);
    house.sessions = mkdtempSync(join(tmpdir(), "unlit-sessions-"));
    await house.start(...options);
    house.browser = await chromium.launch({ executablePath: chromiumPath, args: ["--no-sandbox"] });
    return house;
  }

  /** Starts the daemon and waits until it says that it listens. */
  async start(...options) {
    assert.ok(existsSync(program), `${program} is not there; run: cargo build`);
    const child = spawn(program, ["serve", "--listen", "127.0.0.1:0", "--sessions", this.sessions, ...options], {
      stdio: ["ignore", "pipe", "inherit"],
    });
    this.daemon = child;
    this.url = await new Promise((resolve, reject) => {
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
  }

  /** Ends the daemon, which has to end well. */
  async stop() {
    const child = this.daemon;
    this.daemon = undefined;
    const ended = new Promise((resolve) => {
      child.removeAllListeners("exit");
      child.on("exit", resolve);
    });
    child.kill("SIGTERM");
    assert.equal(await ended, 0, "the daemon did not end cleanly");
  }

  async close() {
    await this.browser?.close();
    if (this.daemon) await this.stop();
    if (this.sessions) rmSync(this.sessions, { recursive: true });
  }

  /** A page, and what it complains of. `prepare` may change it before it is loaded. */
  async visit(width, height, prepare = async () => {}, options = {}) {
    const page = await this.browser.newPage({ viewport: { width, height }, ...options });
    page.setDefaultTimeout(PATIENCE);
    const complaints = [];
    page.on("pageerror", (error) => complaints.push(error.message));
    page.on("console", (message) => message.type() === "error" && complaints.push(message.text()));
    await prepare(page);
    await page.goto(this.url);
    return { page, complaints };
  }

  /** Asks the API as a script would; the answer's JSON. */
  async api(method, path, body) {
    const answer = await fetch(new URL(`/api/v1${path}`, this.url), {
      method,
      headers: body === undefined ? {} : { "Content-Type": "application/json" },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
    const text = await answer.text();
    assert.ok(answer.ok, `${method} ${path}: ${answer.status} ${text}`);
    return text === "" ? undefined : JSON.parse(text);
  }
}

export const shot = (page, name) => page.screenshot({ path: join(shots, `${name}.png`), fullPage: true });
