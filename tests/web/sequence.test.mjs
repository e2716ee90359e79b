// A sequence on the page: planned, walked through with the space bar, paused, seen by others, after a reload too.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { House, shot } from "./house.mjs";

let house;

before(async () => {
  house = await House.open("--studio");
  await house.api("POST", "/sessions", { name: "walk" });
});

after(() => house?.close());

const sequence = () => house.api("GET", "/sessions/walk/sequence");

test("the space bar takes position after position, a pause holds over a reload, and a second page sees it all", async () => {
  const { page, complaints } = await house.visit(1280, 1000);
  const second = await house.visit(390, 844);
  const panel = page.locator("section.sequence");
  await panel.getByText("Plan a sequence").click();
  await panel.getByLabel("Positions").fill("3");
  await panel.getByLabel("Frames of each pair").selectOption("on_off");
  await panel.getByRole("button", { name: "Plan" }).click();
  await panel.getByRole("button", { name: "Start" }).click();
  await page.getByText("Position 1 of 3: get ready, then press space.").waitFor();
  await page.getByRole("button", { name: "Take position 1" }).waitFor();
  await shot(page, "sequence-1280");
  await page.keyboard.press("Space");
  await page.getByText("Position 2 of 3: move on, then press space.").waitFor();
  await panel.getByText("1 of 3 positions done").waitFor();
  await second.page.getByText("Position 2 of 3: move on, then press space.").waitFor();
  await shot(second.page, "sequence-390");
  const wider = await second.page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
  assert.ok(wider <= 0, `the page is ${wider} px wider than the telephone`);

  await second.page.getByRole("button", { name: "Pause" }).click();
  await page.getByText("Paused at position 2 of 3").waitFor();
  await page.reload();
  await page.getByText("Paused at position 2 of 3").waitFor();
  await page.keyboard.press("Space");
  await page.getByText("Position 2 of 3: move on, then press space.").waitFor();
  assert.equal((await sequence()).done, 1, "to resume takes no pair");
  await page.keyboard.press("Space");
  await page.getByText("Position 3 of 3: move on, then press space.").waitFor();
  await second.page.getByRole("button", { name: "Skip" }).click();
  await page.getByText("2 of 3 positions are done; skipped: 3.").first().waitFor();
  const now = await sequence();
  assert.deepEqual([now.plan.order, now.plan.off_frames], ["on_off", 1]);
  assert.deepEqual(
    now.positions.map(({ accepted, skipped }) => [accepted, skipped]),
    [
      [1, false],
      [2, false],
      [null, true],
    ],
  );
  await shot(page, "sequence-done-1280");
  await panel.getByRole("button", { name: "New sequence" }).click();
  await panel.getByText("Plan a sequence").waitFor();
  await page.getByRole("button", { name: "Take pair" }).waitFor();
  assert.deepEqual([...complaints, ...second.complaints], []);
  await page.close();
  await second.page.close();
});

test("a countdown is counted down on the page and takes the pair by itself", async () => {
  const { page, complaints } = await house.visit(1280, 1000);
  const panel = page.locator("section.sequence");
  await panel.getByText("Plan a sequence").click();
  await panel.getByLabel("Positions").fill("1");
  await panel.getByLabel("Each position waits for").selectOption("countdown");
  await panel.getByLabel("Seconds to walk").fill("2");
  await panel.getByRole("button", { name: "Plan" }).click();
  await panel.getByRole("button", { name: "Start" }).click();
  await page.locator(".guide .seconds").waitFor();
  await page.getByText("The position is done.").first().waitFor();
  assert.equal((await sequence()).state, "done");
  assert.deepEqual(complaints, []);
  await page.close();
});
