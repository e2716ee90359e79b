// A calibration on the page: frames with the lens cap on are shot, measured, and the verdict is read.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { House, shot } from "./house.mjs";

let house;

before(async () => {
  house = await House.open("--studio");
  await house.api("POST", "/sessions", { name: "bath" });
});

after(() => house?.close());

const levels = async () => (await house.api("GET", "/sessions/bath/calibration"))[0];

test("dark frames are shot and removed, the levels are measured, and a second page sees the verdict", async () => {
  await house.api("PUT", "/studio/stage", { lens_cap: true });
  const { page, complaints } = await house.visit(1280, 1000);
  const second = await house.visit(390, 844);
  const panel = page.locator("section.calibration");
  await panel.locator("summary").first().focus();
  await page.keyboard.press("Enter");
  await panel.getByText("0 of 6 measured").waitFor();
  const kind = panel.getByRole("button", { name: "Sensor levels" });
  await kind.focus();
  await page.keyboard.press("Enter");
  await panel.getByText("Put the lens cap on and cover the viewfinder.").waitFor();
  const dark = panel.getByRole("group", { name: "Dark frames" });
  for (const n of [1, 2, 3]) {
    await dark.getByRole("button", { name: "Take one" }).click();
    await panel.locator(".shots li").nth(n - 1).waitFor();
    await dark.getByRole("button", { name: "Take one" }).and(page.locator(":enabled")).waitFor();
  }
  await panel.getByRole("button", { name: "Remove shot 3, Dark frames" }).click();
  await panel.locator(".shots li").nth(2).waitFor({ state: "detached" });
  await shot(page, "calibration-guide-1280");

  await second.page.getByText("Calibrate").click();
  await second.page.getByRole("button", { name: "Sensor levels" }).click();
  await second.page.getByRole("button", { name: "Measure", exact: true }).click();
  await page.getByText("1 of 6 measured").waitFor();
  for (const one of [page, second.page]) {
    await one.locator(".result").getByText("At ISO 100 black is 20").waitFor();
    await one.locator(".result dl div").first().waitFor();
    await one.waitForFunction(() => document.querySelector(".result img")?.naturalWidth > 0);
  }
  await shot(page, "calibration-measured-1280");
  await shot(second.page, "calibration-measured-390");
  const wider = await second.page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
  assert.ok(wider <= 0, `the page is ${wider} px wider than the telephone`);
  const now = await levels();
  assert.deepEqual([now.shots.length, now.measured.shots], [0, 2]);
  const record = await page.locator(".result").getByRole("link", { name: "Record" }).getAttribute("href");
  const kept = await (await fetch(new URL(record, house.url))).json();
  assert.equal(kept.levels[0].dark_frames, 2);
  assert.deepEqual([...complaints, ...second.complaints], []);
  await page.close();
  await second.page.close();
});

test("what is no raw file is refused in words, and the others' guides can be read", async () => {
  const { page, complaints } = await house.visit(1280, 1000);
  const panel = page.locator("section.calibration");
  await panel.getByText("Calibrate").click();
  for (const name of ["Noise and linearity", "Exposure table", "Vignetting", "Flash", "Colour"]) {
    const kind = panel.getByRole("button", { name, exact: false }).first();
    await kind.click();
    await panel.getByRole("img").first().waitFor();
    await shot(page, `calibration-${name.split(" ")[0].toLowerCase()}-1280`);
    await kind.click();
  }
  await panel.getByRole("button", { name: "Vignetting" }).click();
  const file = { name: "flat.dng", mimeType: "image/x-adobe-dng", buffer: Buffer.from("no raw at all") };
  await panel.getByLabel("Or send raw files").setInputFiles(file);
  await page.getByText("flat.dng is no camera raw file").waitFor();
  assert.equal(complaints.filter((said) => !said.includes("422")).length, 0, complaints.join("\n"));
  await page.close();
});
