// Print the report of Khronos's validator on each file that is named, one JSON object a line.
const fs = require("fs");
const validator = require("gltf-validator");
(async () => {
  for (const path of process.argv.slice(2)) {
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(path)));
    console.log(JSON.stringify({ path, ...report.issues }));
  }
})();
