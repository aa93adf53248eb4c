// Runs the Khronos glTF validator on a file and prints its issues as JSON.
//
//   check_glb.js NODE_MODULES FILE.glb
const fs = require("fs");
const path = require("path");
const validator = require(path.join(process.argv[2], "gltf-validator"));

validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[3]))).then((report) => {
  console.log(JSON.stringify({ ...report.issues, info: report.info }));
});
