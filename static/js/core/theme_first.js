// @ts-check
// Sets the chosen theme before the first paint, so that the page does not flash in the other one.

try {
  const { theme } = JSON.parse(localStorage.getItem("unghost.prefs.v1") ?? "{}");
  if (theme === "light" || theme === "dark") document.documentElement.dataset.theme = theme;
} catch {
  // Unreadable preferences are no reason to show nothing.
}
