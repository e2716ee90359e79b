// A second copy that fails stands on the page as long as it does.

import assert from "node:assert/strict";
import { mkdirSync, mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { House, shot } from "./house.mjs";

const disk = mkdtempSync(join(tmpdir(), "unlit-mirror-"));
const mirrors = join(disk, "mounted");
let house;

before(async () => {
  house = await House.open("--studio", "--mirror", mirrors);
});

after(async () => {
  await house?.close();
  rmSync(disk, { recursive: true });
});

test("a mirror that is not there is told until it is, to whoever comes late too", async () => {
  const early = await house.visit(1280, 900);
  await early.page.locator(".devices .ready").nth(1).waitFor();
  await house.api("POST", "/sessions", { name: "vase" });
  await early.page.getByRole("alert").getByText("is the disk plugged in and mounted?").waitFor();
  await early.page.getByText("no second copy").waitFor();
  const late = await house.visit(390, 844);
  await late.page.getByRole("alert").getByText("is the disk plugged in and mounted?").waitFor();
  await shot(late.page, "mirror-390");

  mkdirSync(mirrors);
  for (const { page, complaints } of [early, late]) {
    await page.locator(".notice.mirror").waitFor({ state: "detached" });
    await page.getByText("no second copy").waitFor({ state: "detached" });
    assert.deepEqual(complaints, []);
    await page.close();
  }
});
