// Positions of the joints of two BVH files and a GLB as three.js reads them, and what Khronos' validator says of the GLB.
// `node all_files.mjs FOLDER FIXTURE` reads FOLDER/{about.json, bvhio.json, *.bvh, motion.glb} and writes FIXTURE.

import { readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';

import { validateBytes, version } from 'gltf-validator';
import { AnimationMixer, LoopOnce, REVISION, Vector3 } from 'three';
import { BVHLoader } from 'three/addons/loaders/BVHLoader.js';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';

const [folder, fixture] = process.argv.slice(2);
const read = (name) => readFileSync(join(folder, name));
const about = JSON.parse(read('about.json'));

// [frame][joint][x, y, z], metres, as a viewer shows them: through the mixer.
function positions(root, clip, names, scale) {
  const mixer = new AnimationMixer(root);
  const action = mixer.clipAction(clip);
  action.setLoop(LoopOnce);
  action.clampWhenFinished = true;
  action.play();
  const joints = names.map((name) => root.getObjectByName(name));
  return Array.from({ length: about.frames }, (_, frame) => {
    mixer.setTime(frame * about.frame_time);
    root.updateMatrixWorld(true);
    return joints.map((joint) =>
      joint.getWorldPosition(new Vector3()).toArray().map((value) => Number((value * scale).toFixed(5))));
  });
}

function bvh(name) {
  const { skeleton, clip } = new BVHLoader().parse(read(name).toString('utf8'));
  return positions(skeleton.bones[0], clip, about.bvh_names, 0.01);
}

const bytes = new Uint8Array(read('motion.glb'));
const glb = await new GLTFLoader().parseAsync(bytes.buffer, '');
const { issues } = await validateBytes(bytes);
const length = new DataView(bytes.buffer).getUint32(12, true);
const document = JSON.parse(new TextDecoder().decode(bytes.subarray(20, 20 + length)));

const readings = [
  { reader: `three r${REVISION} BVHLoader`, 'rigid.bvh': bvh('rigid.bvh'), 'positions.bvh': bvh('positions.bvh') },
  JSON.parse(read('bvhio.json')),
  { reader: `three r${REVISION} GLTFLoader`, 'motion.glb': positions(glb.scene, glb.animations[0], about.glb_names, 1) },
];
const validator = {
  reader: `gltf-validator ${version()}`,
  errors: issues.numErrors, warnings: issues.numWarnings, infos: issues.numInfos, hints: issues.numHints,
  messages: issues.messages.map(({ code, pointer, message }) => ({ code, pointer, message })),
};
const text = (key) => read(key).toString('utf8').trimEnd().split('\n');
// A joint of three numbers on one line.
const files = { 'rigid.bvh': text('rigid.bvh'), 'positions.bvh': text('positions.bvh') };
const lines = JSON.stringify({ validator, readings, files, document }, null, 1)
  .replace(/\[\s+(-?[\d.e-]+),\s+(-?[\d.e-]+),\s+(-?[\d.e-]+)\s+\]/g, '[$1,$2,$3]')
  .replace(/\],\s+\[(?=-?\d)/g, '],[');
writeFileSync(fixture, `${lines}\n`);
console.log(`${fixture}: ${validator.errors} errors, ${validator.warnings} warnings of the glTF validator`);
