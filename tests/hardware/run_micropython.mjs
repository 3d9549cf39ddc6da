// Runs the firmware's own tests under MicroPython, and measures its memory:
// node run_micropython.mjs MICROPYTHON FILES...
import fs from "node:fs";
import path from "node:path";

const [micropython, ...files] = process.argv.slice(2);
const { loadMicroPython } = await import(path.resolve(micropython));

async function start() {
  const mp = await loadMicroPython({ stdout: (line) => console.log(line), linebuffer: true });
  mp.FS.mkdir("/hardware");
  mp.FS.mkdir("/hardware/firmware");
  for (const file of files) {
    const folder = path.basename(path.dirname(file)) === "firmware" ? "/hardware/firmware/" : "/";
    mp.FS.writeFile(folder + path.basename(file), fs.readFileSync(file));
  }
  mp.runPython(`
import sys
sys.path.append("/")
`);
  return mp;
}

try {
  const checks = await start();
  checks.runPython(`
print(sys.implementation.name, *sys.version_info[:3])
import firmware_checks
print(firmware_checks.run_all(), "passed")
`);
  for (const size of ["2, 1", "6, 2"]) {
    const load = await start();
    const run = (line) => load.runPython(line); // garbage is collected between two of these
    run("import firmware_load");
    run("firmware_load.live()");
    run("before = firmware_load.live()");
    run("from hardware.firmware.firmware import Firmware");
    run(`board = firmware_load.Board(${size}); firmware = Firmware(board)`);
    run("in_use = firmware_load.live() - before");
    run("load = firmware_load.Load(board, firmware)");
    for (let pass = 0; pass < 400; pass++) {
      run("firmware_load.live()");
      run("load.run()");
    }
    run("load.tell(in_use)");
  }
} catch (error) {
  console.log(error.message); // without the text of the interpreter itself
  process.exit(1);
}
