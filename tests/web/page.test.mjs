// The control page in Debian's chromium, against `unlit serve --studio`: the very drivers, a simulated world.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { House, shot } from "./house.mjs";

let house;

before(async () => {
  house = await House.open("--studio");
});

after(() => house?.close());

test("the space bar takes a pair, which is listed with thumbnails and verdict", async () => {
  const { page, complaints } = await house.visit(1280, 900);
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
  await page.getByText(/room for \d+ more/).waitFor();
  await shot(page, "pair-1280");
  assert.deepEqual(complaints, []);
  await page.close();
});

test("the button takes a pair, and a second page sees it, on a telephone too", async () => {
  const first = await house.visit(1280, 900);
  const second = await house.visit(390, 844);
  await first.page.getByRole("button", { name: "Take pair" }).click();
  await second.page.locator('[data-pair="2"]').getByText("Accepted").waitFor();
  const wider = await second.page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
  assert.ok(wider <= 0, `the page is ${wider} px wider than the telephone`);
  await shot(second.page, "pair-390");
  assert.deepEqual([...first.complaints, ...second.complaints], []);
  await first.page.close();
  await second.page.close();
});

test("the flash is told pair by pair: both frames proven, energies with their deviation", async () => {
  const { page, complaints } = await house.visit(1280, 900);
  const flash = page.locator(".flash");
  await flash.locator("circle").nth(1).waitFor();
  assert.equal(await flash.locator("circle").count(), 2);
  await flash.getByText("2 of 2 pairs are proven dark and lit").waitFor();
  assert.match(await flash.locator("title").first().textContent(), /Pair 1: [01]\.\d{4} ± 0\.000\d/);
  await page.locator(".last").getByText("the frame without flash is proven dark; one pulse of").waitFor();
  await shot(page, "flash-1280");
  assert.deepEqual(complaints, []);
  await page.close();
});

test("typing a space into the name of a session takes no pair", async () => {
  const { page, complaints } = await house.visit(1280, 900);
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
  const { page } = await house.visit(1280, 900);
  await page.locator(".devices .ready").first().waitFor();
  await house.stop();
  await page.getByText("No connection").waitFor();
  await shot(page, "lost-1280");
  await page.close();
});

test("without devices the page says what is missing", async () => {
  await house.start("--flash", "none", "--camera", "ptpip:127.0.0.1:9:9");
  const { page } = await house.visit(390, 844);
  await page.locator(".devices .missing").nth(1).getByText("no flash controller found").waitFor();
  await shot(page, "bare-390");
  await page.close();
  await house.stop();
});
