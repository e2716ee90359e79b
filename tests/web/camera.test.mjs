// Live view, region, exposure and histograms on the page, against the simulated camera behind the real drivers.
// What the simulated camera cannot be brought to say is answered in its place, and the test's name says so.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { House, shot } from "./house.mjs";

let house;

before(async () => {
  house = await House.open("--studio");
  await house.api("POST", "/sessions", { name: "camera" });
});

after(() => house?.close());

async function withLiveView(width, height, options) {
  const visited = await house.visit(width, height, undefined, options);
  await visited.page.getByRole("button", { name: "Live view" }).click();
  await picture(visited.page);
  return visited;
}

const picture = (page) => page.waitForFunction(() => document.querySelector(".picture img")?.naturalWidth > 0);

const session = () => house.api("GET", "/sessions/camera");

/** Waits until the session says what is wanted; its last word is told if it never does. */
async function until(wanted, what) {
  const end = Date.now() + 15_000;
  for (;;) {
    const said = await session();
    if (wanted(said)) return said;
    assert.ok(Date.now() < end, `${what}: ${JSON.stringify(said)}`);
    await new Promise((resume) => setTimeout(resume, 100));
  }
}

function near(found, wanted, name) {
  for (const side of ["x", "y", "width", "height"]) {
    assert.ok(Math.abs(found[side] - wanted[side]) < 0.02, `${name}: ${JSON.stringify(found)}`);
  }
}

test("the live picture is shown and goes on moving until it is ended", async () => {
  const { page, complaints } = await withLiveView(1280, 900);
  const first = await page.locator(".picture img").getAttribute("src");
  await page.waitForFunction((before) => document.querySelector(".picture img")?.src !== before, first);
  await shot(page, "live-1280");
  await page.getByRole("button", { name: "End live view" }).click();
  await page.locator(".picture").waitFor({ state: "detached" });
  assert.deepEqual(complaints, []);
  await page.close();
});

test("a region drawn with the mouse is kept over a reload and cleared by its button", async () => {
  const { page, complaints } = await withLiveView(1280, 900);
  const box = await page.locator(".region").boundingBox();
  const at = (x, y) => [box.x + box.width * x, box.y + box.height * y];
  await page.mouse.move(...at(0.7, 0.9));
  await page.mouse.down();
  await page.mouse.move(...at(0.5, 0.5), { steps: 4 });
  await page.mouse.move(...at(0.3, 0.2));
  await page.mouse.up();
  const { region } = await until((said) => said.region, "the region was not kept");
  near(region, { x: 0.3, y: 0.2, width: 0.4, height: 0.7 }, "drawn from the lower right corner");

  await page.reload();
  await picture(page);
  const drawn = await page.locator(".drawn").boundingBox();
  const frame = await page.locator(".region").boundingBox();
  near(
    {
      x: (drawn.x - frame.x) / frame.width,
      y: (drawn.y - frame.y) / frame.height,
      width: drawn.width / frame.width,
      height: drawn.height / frame.height,
    },
    region,
    "drawn after the reload",
  );
  await shot(page, "region-1280");
  await page.getByRole("button", { name: "Clear region" }).click();
  await page.locator(".drawn").waitFor({ state: "detached" });
  await until((said) => !said.region, "the region was not cleared");
  assert.deepEqual(complaints, []);
  await page.close();
});

test("a click on the picture is no region", async () => {
  const { page } = await withLiveView(1280, 900);
  await page.locator(".region").click();
  await page.locator(".region").press("ArrowLeft", { delay: 20 });
  // The key made the first region; had the click made one, the key would have moved that instead.
  const { region } = await until((said) => said.region, "the key made no region");
  near(region, { x: 0.25, y: 0.25, width: 0.5, height: 0.5 }, "made by the key");
  await page.close();
});

test("keys move, size and clear the region", async () => {
  const { page, complaints } = await withLiveView(1280, 900);
  const frame = page.locator(".region");
  await page.locator(".drawn").waitFor();
  for (let i = 0; i < 5; i++) await frame.press("ArrowRight");
  for (let i = 0; i < 10; i++) await frame.press("Shift+ArrowUp");
  const { region } = await until((said) => said.region?.height < 0.45, "the keys changed nothing");
  near(region, { x: 0.3, y: 0.25, width: 0.5, height: 0.4 }, "changed by keys");
  await frame.press("Delete");
  await until((said) => !said.region, "the key did not clear it");
  assert.deepEqual(complaints, []);
  await page.close();
});

test("a region made by keys is kept though the live view is ended at once", async () => {
  const { page } = await withLiveView(1280, 900);
  await page.locator(".region").press("Enter");
  // By script, so that no time goes by between the key and the end.
  await page.evaluate(() => [...document.querySelectorAll("button")].find((b) => b.innerText === "End live view").click());
  await until((said) => said.region, "the region was lost");
  await house.api("PUT", "/sessions/camera/region", null);
  await page.close();
});

test("a finger draws the region on a telephone", async () => {
  const { page, complaints } = await withLiveView(390, 844, { hasTouch: true, isMobile: true });
  const finger = await page.context().newCDPSession(page);
  const box = await page.locator(".region").boundingBox();
  const touch = (type, x, y) =>
    finger.send("Input.dispatchTouchEvent", {
      type,
      touchPoints: type === "touchEnd" ? [] : [{ x: box.x + box.width * x, y: box.y + box.height * y }],
    });
  await touch("touchStart", 0.2, 0.1);
  for (const step of [0.3, 0.5, 0.7, 0.8]) await touch("touchMove", step, step);
  await touch("touchEnd");
  const { region } = await until((said) => said.region, "the finger drew no region");
  near(region, { x: 0.2, y: 0.1, width: 0.6, height: 0.7 }, "drawn by finger");
  await page.locator(".drawn").waitFor();
  await shot(page, "region-390");
  assert.deepEqual(complaints, []);
  await page.close();
});

test("an exposure chosen from the camera's lists is set and shown on every page", async () => {
  const first = await house.visit(1280, 900);
  const second = await house.visit(390, 844);
  const { page } = first;
  await page.getByLabel("Shutter").selectOption({ label: "1/100 s" });
  await page.getByLabel("Aperture").selectOption({ label: "f/13" });
  await page.getByLabel("ISO").selectOption({ label: "100" });
  await page.getByRole("button", { name: "Set", exact: true }).click();
  for (const shown of [first.page, second.page]) await shown.getByText("Locked at 1/100 s, f/13, ISO 100.").waitFor();
  const { exposure } = await session();
  assert.deepEqual(exposure.on, { shutter_s: 0.01, aperture: 13, iso: 100 });
  assert.deepEqual(exposure.off, exposure.on);

  const wider = await second.page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
  assert.ok(wider <= 0, `the page is ${wider} px wider than the telephone`);
  await shot(second.page, "exposure-390");
  assert.deepEqual([...first.complaints, ...second.complaints], []);
  await page.close();
  await second.page.close();
});

test("the frame without flash has an exposure of its own if it is wished", async () => {
  const { page, complaints } = await house.visit(1280, 900);
  await page.getByText("Locked at 1/100 s, f/13").waitFor();
  await page.getByLabel("Another exposure without flash").check();
  const unlit = page.getByRole("group", { name: "Without flash" });
  await unlit.getByLabel("Shutter").selectOption({ label: "1/50 s" });
  await page.getByRole("button", { name: "Set", exact: true }).click();
  await until((said) => said.exposure.off.shutter_s === 0.02, "the unlit exposure was not set");
  await page.reload();
  assert.equal(await unlit.getByLabel("Shutter").inputValue(), "0.02");
  await page.getByLabel("Another exposure without flash").uncheck();
  await page.getByRole("button", { name: "Set", exact: true }).click();
  await until((said) => said.exposure.off.shutter_s === 0.01, "the unlit exposure was not dropped");
  assert.deepEqual(complaints, []);
  await page.close();
});

test("after a pair its raw histograms are shown, and the space bar works after a click on the scale", async () => {
  const { page, complaints } = await house.visit(1280, 900);
  await page.locator(".devices .ready").nth(1).waitFor();
  await page.getByText("Locked at").waitFor();
  await page.keyboard.press("Space");
  await page.locator('[data-pair="1"]').waitFor();
  await page.locator(".histogram svg").nth(1).waitFor();
  const outlines = () =>
    page.locator(".histogram path").evaluateAll((paths) => paths.map((path) => path.getAttribute("d")));
  const logarithmic = await outlines();
  assert.equal(logarithmic.length, 6, "red, green and blue of both frames");
  assert.equal(await page.locator(".histogram .saturation").count(), 2);
  const server = await house.api("GET", "/sessions/camera/pairs/1/on/histogram");
  const shares = await page.locator(".histogram").nth(1).locator("tbody tr").allInnerTexts();
  server.colours.forEach((colour, i) => {
    const share = Math.round((colour.maximum_dn - colour.from_dn) / (colour.to_dn - colour.from_dn) * 100);
    if (share >= 10) assert.match(shares[i], new RegExp(`\\b${share} %`), colour.colour);
  });
  await page.getByRole("button", { name: "Linear" }).click();
  assert.notDeepEqual(await outlines(), logarithmic);
  await shot(page, "histogram-1280");

  await page.keyboard.press("Space");
  await page.locator('[data-pair="2"]').waitFor();
  await page.getByRole("heading", { name: "Pair 2" }).waitFor();
  assert.deepEqual(complaints, []);
  await page.close();
});

test("an overexposed pair is rejected with its figure behind the sentence", async () => {
  const wide = { shutter_s: 0.01, aperture: 4, iso: 100 };
  await house.api("PUT", "/sessions/camera/exposure", { on: wide });
  const { page } = await house.visit(1280, 900);
  await page.getByText("Locked at 1/100 s, f/4").waitFor();
  await page.keyboard.press("Space");
  const card = page.locator('[data-pair="3"]');
  await card.getByText("Rejected").waitFor();
  assert.ok(!(await card.getByText("Measured").isVisible()));
  await card.locator("summary").first().click();
  await card.getByText("(overexposed)").waitFor();
  await page.locator(".histogram td.some").first().waitFor();
  await shot(page, "rejected-1280");
  await page.close();
});

test("finding the exposure locks what it found and tells how bright the next lit frame will be", async () => {
  const { page, complaints } = await house.visit(1280, 900);
  await page.getByRole("button", { name: "Find exposure" }).click();
  await page.locator(".found").getByText("of saturation").waitFor();
  await shot(page, "found-1280");
  const jobs = await house.api("GET", "/jobs");
  const { result } = jobs.find((job) => job.kind === "find_exposure");
  assert.ok(result.shots <= 4, `${result.shots} test shots`);
  const use = page.getByRole("button", { name: "Use it" });
  if (await use.isVisible()) await use.click();
  await page.getByText(`Locked at ${result.exposure.words}.`).waitFor();
  assert.deepEqual(complaints, []);
  await page.close();
});

const LOCK = [
  { name: "focus", state: "wrong", value: "AF", sentence: "Focus stands on AF; put the lens to MF." },
  { name: "x_sync", state: "warning", value: "1/250", sentence: "The shutter is faster than the X-sync time." },
  { name: "noise_reduction", state: "unreadable", value: "", sentence: "Is noise reduction off?" },
  { name: "stabiliser", state: "unreadable", value: "", sentence: "Is the stabiliser off?" },
  { name: "white_balance", state: "locked", value: "Daylight", sentence: "White balance stands on Daylight." },
];

test("what the camera does not tell is asked once a session (lock made up, answers kept by the daemon)", async () => {
  const { camera } = await house.api("GET", "/camera").then((said) => ({ camera: { ...said, lock: LOCK } }));
  const { page, complaints } = await house.visit(1280, 900, (fresh) =>
    fresh.route("**/api/v1/camera", (route) => route.fulfill({ json: camera })),
  );
  await page.getByRole("alert").getByText("put the lens to MF").waitFor();
  await page.getByText("faster than the X-sync time").waitFor();
  await shot(page, "lock-1280");
  const asked = page.getByRole("button", { name: "I have checked this" });
  await asked.nth(1).waitFor();
  await asked.first().click();
  await until((said) => said.confirmed.includes("noise_reduction"), "the first answer was not kept");
  await page.reload();
  await page.getByText("Is the stabiliser off?").waitFor();
  assert.equal(await asked.count(), 1);
  await asked.click();
  await asked.waitFor({ state: "detached" });
  await page.getByText("3 settings as needed").waitFor();
  assert.deepEqual((await session()).confirmed, ["noise_reduction", "stabiliser"]);
  assert.deepEqual(complaints, []);
  await page.close();
});

test("one of several cameras is chosen (list made up, choice seen on its way)", async () => {
  const listed = [
    { model: "Canon EOS 5DS", port: "usb:001,004", in_use: true },
    { model: "Nikon D810", port: "usb:001,005", in_use: false },
  ];
  let chosen;
  const { page } = await house.visit(1280, 900, async (fresh) => {
    await fresh.route("**/api/v1/cameras", (route) => route.fulfill({ json: listed }));
    await fresh.route("**/api/v1/camera", (route) => {
      if (route.request().method() !== "PUT") return route.continue();
      chosen = route.request().postDataJSON();
      return route.fulfill({ json: {} });
    });
  });
  const choice = page.getByLabel("Camera in use");
  await choice.waitFor();
  assert.equal(await choice.inputValue(), "usb:001,004");
  await choice.selectOption("usb:001,005");
  await page.waitForFunction(() => document.querySelector(".choice select").value === "usb:001,005");
  assert.deepEqual(chosen, { port: "usb:001,005" });
  await page.close();
});

test("with one camera there is no choice of cameras", async () => {
  const listed = await fetch(new URL("/api/v1/cameras", house.url));
  assert.equal((await listed.json()).length, 1);
  const { page } = await house.visit(1280, 900);
  // The page has its answer: a browser that reloads forgets the bodies of the document before.
  await page.waitForFunction(() =>
    performance.getEntriesByType("resource").some((r) => r.name.endsWith("/api/v1/cameras") && r.responseEnd > 0),
  );
  await page.locator(".dials").waitFor();
  assert.equal(await page.locator(".choice").count(), 0);
  await page.close();
});

test("a device that is brought back is told calmly and forgotten when the pair ends (events made up)", async () => {
  const words = "The camera did not answer within 12 s; it is started again.";
  const job = { id: 9, kind: "pair", session: "camera", stage: "Bringing the devices back", done: 1, total: 6 };
  const happened = (topic, data, said = "") => `event: ${topic}\ndata: ${JSON.stringify({ words: said, data })}\n\n`;
  const { version, devices } = await new Promise((resolve, reject) => {
    // The first event of the real stream is the state of this very house.
    fetch(new URL("/api/v1/events", house.url)).then(async (answer) => {
      const reader = answer.body.getReader();
      const { value } = await reader.read();
      await reader.cancel();
      resolve(JSON.parse(/^data: (.*)$/m.exec(new TextDecoder().decode(value))[1]));
    }, reject);
  });
  const state = { version, devices, session: "camera", jobs: [], prompt: null, sequences: [], studio: null };
  const begin = `retry: 600000\nevent: state\ndata: ${JSON.stringify(state)}\n\n`;
  const running = begin + happened("job", { ...job, state: "running" }) + happened("recovery", {}, words);
  const open = (stream) =>
    house.visit(1280, 900, (fresh) =>
      fresh.route("**/api/v1/events", (route) => route.fulfill({ contentType: "text/event-stream", body: stream })),
    );
  const { page: during } = await open(running);
  await during.getByText(words).waitFor();
  assert.equal(await during.locator(".notice.trouble").count(), 0);
  await during.close();
  const { page: later } = await open(running + happened("job", { ...job, state: "done" }));
  await later.locator('[data-pair="1"]').waitFor();
  assert.equal(await later.getByText(words).count(), 0);
  await later.close();
});
