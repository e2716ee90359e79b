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
  await panel.getByText("0 of 7 measured").waitFor();
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
  await panel.getByRole("button", { name: "Throw away shot 3, Dark frames" }).click();
  await panel.locator(".shots li").nth(2).waitFor({ state: "detached" });
  await shot(page, "calibration-guide-1280");

  await second.page.locator("section.calibration summary").first().click();
  await second.page.getByRole("button", { name: "Sensor levels" }).click();
  await second.page.getByRole("button", { name: "Measure", exact: true }).click();
  await page.getByText("1 of 7 measured").waitFor();
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
  await panel.locator("summary").first().click();
  for (const name of ["Noise and linearity", "Exposure table", "Vignetting", "Flash", "Repeatability", "Colour"]) {
    const kind = panel.getByRole("button", { name, exact: false }).first();
    await kind.click();
    await panel.getByRole("img").first().waitFor();
    await shot(page, `calibration-${name.split(" ")[0].toLowerCase()}-1280`);
    await kind.click();
  }
  await panel.getByRole("button", { name: "Colour" }).first().click();
  await panel.locator("summary", { hasText: /^More$/ }).click();
  const corners = panel.getByLabel("Corner patches of the chart");
  const taken = async (points) => {
    await corners.fill(points);
    return corners.evaluate((field) => field.checkValidity());
  };
  assert.ok(await taken("100,120 900,120.5 900,700 100,700"));
  assert.ok(!(await taken("100,120 900,120")));
  assert.ok(!(await taken("1,2 3,4 5,6 7")));
  await panel.getByRole("button", { name: "Colour" }).first().click();

  await panel.getByRole("button", { name: "Vignetting" }).click();
  const file = { name: "flat.dng", mimeType: "image/x-adobe-dng", buffer: Buffer.from("no raw at all") };
  await panel.getByLabel("Or send raw files").setInputFiles(file);
  await page.getByText("flat.dng is no camera raw file").waitFor();
  assert.equal(complaints.filter((said) => !said.includes("422")).length, 0, complaints.join("\n"));
  await page.close();
});

test("a ladder climbs by the dials, shots are judged at once, and polariser and power are told", async () => {
  await house.api("PUT", "/studio/stage", { card_distance_m: 1 });
  const { page, complaints } = await house.visit(1280, 1000);
  const panel = page.locator("section.calibration");
  await panel.locator("summary").first().click();
  const before = (await house.api("GET", "/camera")).exposure;
  await panel.getByRole("button", { name: "Exposure table" }).click();
  const steps = panel.getByRole("group", { name: "Steps" });
  await steps.getByText("0 of 30 good").waitFor();
  await steps.getByText("Dials for the next shot").first().click();
  await steps.getByLabel("From shot to shot").selectOption("iso");
  await steps.getByRole("spinbutton", { name: "Steps" }).fill("3");
  await shot(page, "calibration-ladder-1280");
  await steps.getByRole("button", { name: "Take 3 steps" }).click();
  await panel.locator(".shots li").nth(2).waitFor();
  await steps.getByRole("button", { name: "Take 3 steps" }).and(page.locator(":enabled")).waitFor();
  const state = (await house.api("GET", "/sessions/bath/calibration")).find((one) => one.kind === "exposure");
  const isos = state.shots.map((one) => one.iso);
  assert.ok(isos[0] < isos[1] && isos[1] < isos[2], `ISO ${isos}`);
  assert.deepEqual((await house.api("GET", "/camera")).exposure, before);
  for (const lack of state.lacks) await panel.getByText(lack).waitFor();
  await shot(page, "calibration-climbed-1280");

  // A frame with the lens cap on is no flat field: said at once, and thrown away.
  await panel.getByRole("button", { name: "Exposure table" }).click();
  await house.api("PUT", "/studio/stage", { lens_cap: true });
  await panel.getByRole("button", { name: "Vignetting" }).click();
  await panel.getByRole("button", { name: "Take one" }).click();
  await panel.getByText("Too dark: the middle should be at about half of saturation.").waitFor();
  await panel.getByText("0 of 5 good").waitFor();
  await shot(page, "calibration-fault-1280");
  await panel.getByRole("button", { name: "Throw away shot 1, Even frames" }).click();
  await panel.getByText("No shots yet.").waitFor();

  await panel.getByText("Polariser and flash power").click();
  await panel.getByLabel("A polariser is before the lens").check();
  await panel.getByLabel("Its angle").fill("30");
  await panel.getByLabel("Power of the flash").fill("0.5");
  await panel.getByRole("button", { name: "Set", exact: true }).click();
  await panel.getByText("polariser at 30, flash at 0.5 of its power").waitFor();
  await panel.getByRole("button", { name: "Repeatability of the flash" }).click();
  await panel.getByRole("button", { name: "Take 40" }).waitFor();
  await shot(page, "calibration-lighting-1280");
  const { lighting } = await house.api("GET", "/sessions/bath");
  assert.deepEqual(lighting, { polariser: { angle_degrees: 30 }, flash_power: 0.5 });
  assert.deepEqual(complaints, []);
  await page.close();
});
