// Move the edge of every picture of the class "wipe" with its slider.
document.addEventListener("DOMContentLoaded", () => {
  for (const box of document.querySelectorAll(".wipe")) {
    const slider = box.querySelector("input");
    const move = () => box.style.setProperty("--at", `${slider.value}%`);
    slider.addEventListener("input", move);
    move();
  }
});
