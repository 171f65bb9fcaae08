// Inside a report, the replay and the report's cursor move together. FIRST and LAST, times of the
// drive [s], are defined before this script.
if (parent !== window) {
  const put = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
  let wanted = null, shown = 0;
  addEventListener("message", ({ source, data }) => {
    if (source === parent && Number.isFinite(data?.time)) wanted = data.time;
  });
  requestAnimationFrame(function next() {
    const input = document.querySelector(".mantine-NumberInput-input");
    if (input && wanted !== null) {
      // At its end, the player begins again.
      shown = Math.min(Math.max(wanted, FIRST), LAST - 0.01) - FIRST;
      wanted = null;
      put.call(input, shown.toFixed(2));
      input.dispatchEvent(new Event("input", { bubbles: true }));
    } else if (input && Math.abs(Number(input.value) - shown) > 0.06) {
      shown = Number(input.value);
      parent.postMessage({ time: FIRST + shown }, "*");
    }
    requestAnimationFrame(next);
  });
}
