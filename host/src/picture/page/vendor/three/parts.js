// What the pages use of three.js; `build` makes one script of it.
export {
  BackSide, Box3, BufferAttribute, BufferGeometry, Color, DataTexture, DoubleSide, FrontSide, Group, LinearFilter, Mesh, MeshMatcapMaterial, PerspectiveCamera, Points,
  PointsMaterial, Raycaster, Scene, SRGBColorSpace, Vector2, Vector3, WebGLRenderer, WireframeGeometry,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
export { LineMaterial } from "three/addons/lines/LineMaterial.js";
export { LineSegments2 } from "three/addons/lines/LineSegments2.js";
export { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";
