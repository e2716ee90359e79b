// The daemon with a token, before a real browser: the pairing page, its cookie, and a link from another site.

import assert from "node:assert/strict";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { House, PATIENCE } from "./house.mjs";

let house;
let folder;
let said = "";

before(async () => {
  folder = mkdtempSync(join(tmpdir(), "unlit-token-"));
  house = await House.open("--flash", "none", "--token-file", join(folder, "token"));
  house.daemon.stdout.on("data", (bytes) => (said += bytes));
});
after(async () => {
  await house?.close();
  rmSync(folder, { recursive: true });
});

/** The code that the daemon shows, once it does. */
async function code() {
  const begun = Date.now();
  for (;;) {
    const shown = said.match(/pairing code: (\d{4}) (\d{4})/);
    if (shown) return shown[1] + shown[2];
    assert.ok(Date.now() - begun < PATIENCE, `no code was shown; it said: ${said}`);
    await new Promise((resolve) => setTimeout(resolve, 20));
  }
}

test("a code lets a browser in, and it stays in by a link from another site", async () => {
  const { page, complaints } = await house.visit(900, 700);
  await page.getByRole("heading", { name: "Pair this browser" }).waitFor();
  const right = await code();
  assert.deepEqual(complaints, []);

  await page.getByLabel("Code").fill(right === "00000000" ? "00000001" : "00000000");
  await page.getByRole("button", { name: "Pair" }).click();
  await page.getByRole("alert").filter({ hasText: "not the code" }).waitFor();

  await page.getByLabel("Code").fill(right);
  await page.getByRole("button", { name: "Pair" }).click();
  await page.locator("#page").waitFor({ state: "attached" });
  assert.equal(await page.evaluate(() => document.cookie), "", "no script sees the cookie");
  assert.equal(await page.evaluate(() => fetch("/api/v1/jobs").then((answer) => answer.status)), 200);

  // A link from another site, which brings no strict cookie: the pairing page finds out that it is there all the same.
  await page.route("http://elsewhere.test/", (route) =>
    route.fulfill({ contentType: "text/html", body: `<a href="${house.url}">unlit</a>` }),
  );
  await page.goto("http://elsewhere.test/");
  await page.getByRole("link").click();
  await page.locator("#page").waitFor({ state: "attached" });
  await page.context().close();
});
