"use strict";
// Switches work without this script: they are radio buttons. It adds one switch for all frames, and the large view.
const frames = [...document.querySelectorAll("figure.frame")].filter((frame) => frame.querySelector("img"));
const large = document.getElementById("large");
const picture = document.getElementById("large-picture");
const title = document.getElementById("large-title");
let shown = 0;

const inputs = (frame) => [...frame.querySelectorAll("input")];
const viewOf = (frame) => inputs(frame).find((input) => input.checked).value;
const pick = (frame, view) => {
  for (const input of inputs(frame)) if (input.value === view) input.checked = true;
};
const mark = (buttons, key, view) => {
  for (const button of buttons) button.setAttribute("aria-pressed", String(button.dataset[key] === view));
};

for (const group of document.querySelectorAll(".script")) group.hidden = false;
const whole = [...document.querySelectorAll("[data-all]")];
for (const button of whole) {
  button.addEventListener("click", () => {
    for (const frame of frames) pick(frame, button.dataset.all);
    mark(whole, "all", button.dataset.all);
  });
}
mark(whole, "all", "picture");
document.getElementById("gallery").addEventListener("change", () => mark(whole, "all", ""));

function show(number) {
  shown = (number + frames.length) % frames.length;
  const frame = frames[shown];
  const view = viewOf(frame);
  const source = frame.querySelector("img." + view);
  picture.src = source.src;
  picture.alt = source.alt;
  title.textContent = frame.getAttribute("aria-label");
  const buttons = [...large.querySelectorAll("[data-view]")];
  mark(buttons, "view", view);
  for (const button of buttons) button.hidden = !frame.querySelector("img." + button.dataset.view);
}

frames.forEach((frame, number) => {
  frame.querySelector("button.views").addEventListener("click", () => {
    show(number);
    large.showModal();
  });
});
large.addEventListener("click", (event) => {
  const button = event.target.closest("button");
  if (event.target === large || (button && "close" in button.dataset)) large.close();
  else if (button && button.dataset.step) show(shown + Number(button.dataset.step));
  else if (button && button.dataset.view) {
    pick(frames[shown], button.dataset.view);
    show(shown);
  }
});
large.addEventListener("close", () => frames[shown].querySelector("button.views").focus());
large.addEventListener("keydown", (event) => {
  if (event.key === "ArrowLeft") show(shown - 1);
  else if (event.key === "ArrowRight") show(shown + 1);
  else if ("123".includes(event.key)) {
    pick(frames[shown], ["picture", "plants", "classes"][Number(event.key) - 1]);
    show(shown);
  }
});
let start = null;
large.addEventListener("touchstart", (event) => { start = event.touches.length === 1 ? event.touches[0].clientX : null; }, { passive: true });
large.addEventListener("touchend", (event) => {
  const moved = start === null ? 0 : event.changedTouches[0].clientX - start;
  if (Math.abs(moved) > 50) show(shown + (moved < 0 ? 1 : -1));
});
