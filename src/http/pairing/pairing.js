const form = document.getElementById("form");
const code = document.getElementById("code");
const answer = document.getElementById("answer");

// A link from another site brings us here without the cookie, although it is there: asked from here, it comes along.
const enter = () => location.replace("/");
fetch("/api/v1/pairing")
  .then((response) => response.json())
  .then((state) => state.paired && enter())
  .catch(() => {});

form.addEventListener("submit", async (event) => {
  event.preventDefault();
  answer.textContent = "";
  try {
    const response = await fetch("/api/v1/pairing", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ code: code.value }),
    });
    if (response.ok) return enter();
    const problem = await response.json().catch(() => null);
    answer.textContent = problem?.detail ?? `The answer was ${response.status}.`;
  } catch {
    answer.textContent = "The program does not answer. Is it running?";
  }
  code.select();
});
