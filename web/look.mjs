// local
import { chromium } from "playwright-core";
const [url, out, ...acts] = process.argv.slice(2);
const b = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox"] });
for (const [w,h] of [[1280,900],[390,844]]) {
  const p = await b.newPage({ viewport: { width: w, height: h } });
  p.on("console", m => console.log("console", m.text())); p.on("pageerror", e => console.log("pageerror", e.message));
  await p.goto(url); await p.waitForTimeout(800);
  await p.screenshot({ path: `${out}/start-${w}.png` });
  for (const a of acts) {
    if (a === "space") { await p.keyboard.press("Space"); await p.waitForTimeout(250); await p.screenshot({ path: `${out}/during-${w}.png` }); await p.waitForTimeout(2500); }
    if (a === "wait") await p.waitForTimeout(4500);
    if (a === "menu") { await p.click(".session summary"); await p.waitForTimeout(400); await p.screenshot({ path: `${out}/menu-${w}.png` }); await p.click(".session summary"); }
  }
  await p.screenshot({ path: `${out}/end-${w}.png`, fullPage: true });
  await p.close();
}
await b.close();
