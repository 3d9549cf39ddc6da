// Runs the firmware's own tests under MicroPython: node run_micropython.mjs MICROPYTHON FILES...
import fs from "node:fs";
import path from "node:path";

const [micropython, ...files] = process.argv.slice(2);
const { loadMicroPython } = await import(path.resolve(micropython));
const mp = await loadMicroPython({ stdout: (line) => console.log(line), linebuffer: true });
mp.FS.mkdir("/hardware");
mp.FS.mkdir("/hardware/firmware");
for (const file of files) {
  const folder = path.basename(path.dirname(file)) === "firmware" ? "/hardware/firmware/" : "/";
  mp.FS.writeFile(folder + path.basename(file), fs.readFileSync(file, "utf-8"));
}
mp.runPython(`
import sys
sys.path.append("/")
print(sys.implementation.name, *sys.version_info[:3])
import firmware_checks
print(firmware_checks.run_all(), "passed")
`);
