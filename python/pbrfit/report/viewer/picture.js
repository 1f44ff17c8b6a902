// The picture: maps as textures, one triangle, relight.frag for each pixel.

const SHOWN = ["relit", "albedo", "roughness", "metallic", "normals", "strips"];
const TONE_MAPS = ["none", "neutral"];
const MOST_LAMPS = 16; // as in lamps.glsl

class Picture {
  /** @throws Error with a message for the user if there is no WebGL 2, or too little of it */
  constructor(canvas, data, planes, shaders) {
    Object.assign(this, { canvas, data, shaders });
    this.textures = {
      geometry: interleaved([planes.normal_u, planes.normal_v, planes.roughness, planes.facing]),
      surface: interleaved([planes.red, planes.green, planes.blue, planes.metallic]),
    };
    this.gl = canvas.getContext("webgl2", { antialias: false, depth: false });
    if (!this.gl) throw new Error("this browser, or its graphics settings, has no WebGL 2");
    this.prepare();
  }

  /** Textures, and the programs that the first picture needs; again after the browser lost them. */
  prepare() {
    const { gl, data, textures } = this;
    const side = Math.max(data.width, data.height);
    if (side > gl.getParameter(gl.MAX_TEXTURE_SIZE)) {
      throw new Error(`the graphics chip takes no maps of ${side} pixels`);
    }
    this.programs = {};
    this.environment = null; // whose textures there are
    this.ofPanorama = [];
    const integers = [gl.RGBA16UI, gl.RGBA_INTEGER, gl.UNSIGNED_SHORT];
    this.texture(0, data.width, data.height, integers, textures.geometry);
    this.texture(1, data.width, data.height, integers, textures.surface);
    const floats = [gl.RGBA32F, gl.RGBA, gl.FLOAT];
    if (data.lobes) this.texture(2, data.lobes.width, data.lobes.height, floats, data.lobes.texels);
    else this.texture(2, data.bands.length / 4, 1, floats, Float32Array.from(data.bands));
  }

  texture(index, width, height, [stored, given, type], values) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + index);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    }
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, stored, width, height, 0, given, type, values);
  }

  /** Textures of a panorama, if they are not there yet. */
  place(environment) {
    if (this.environment === environment) return;
    const { gl, data } = this;
    for (const texture of this.ofPanorama) gl.deleteTexture(texture);
    const linear = (target, unit, levels) => {
      const texture = gl.createTexture();
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(target, texture);
      gl.texParameteri(target, gl.TEXTURE_WRAP_S, gl.REPEAT);
      gl.texParameteri(target, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
      gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
      gl.texParameteri(target, gl.TEXTURE_MIN_FILTER,
        levels > 1 ? gl.LINEAR_MIPMAP_LINEAR : gl.LINEAR);
      gl.texParameteri(target, gl.TEXTURE_MAX_LEVEL, levels - 1);
      return texture;
    };
    const { levels, hemispheres, unit } = environment;
    const halves = [gl.RGBA, gl.FLOAT];
    const panorama = linear(gl.TEXTURE_2D, 3, levels.length);
    levels.forEach((grid, j) => gl.texImage2D(gl.TEXTURE_2D, j, gl.RGBA16F, grid.columns,
      grid.columns / 2, 0, ...halves, halfTexels(grid, unit)));
    const [{ columns }] = hemispheres;
    const both = linear(gl.TEXTURE_2D_ARRAY, 4, 1);
    const texels = new Float32Array(4 * columns * columns);
    hemispheres.forEach((grid, i) => texels.set(halfTexels(grid, unit), 2 * i * columns * columns));
    gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.RGBA16F, columns, columns / 2, 2, 0, ...halves, texels);
    const bytes = Uint8Array.from(atob(data.environmentLobes.nodes), (c) => c.charCodeAt(0));
    this.texture(5, data.environmentLobes.columns, data.environmentLobes.rows,
      [gl.RGBA32F, gl.RGBA, gl.FLOAT], new Float32Array(bytes.buffer));
    this.ofPanorama = [panorama, both];
    this.environment = environment;
  }

  /** The program for lights of these kinds, made when it is needed first. */
  program(kinds) {
    const key = kinds.join("+");
    this.programs[key] ??= this.compiled(kinds);
    return this.programs[key];
  }

  compiled(kinds) {
    const { gl, data, shaders } = this;
    const model = [kinds.length ? shaders.model : "", ...kinds.map((kind) => shaders[kind])];
    const fragment = ["#version 300 es", ...kinds.map((kind) => `#define ${kind.toUpperCase()}`),
      shaders.fragment.replace("MODEL\n", () => model.join("\n"))].join("\n");
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, `#version 300 es\n${shaders.vertex}`],
      [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`the graphics driver refused the shader: ${gl.getProgramInfoLog(program)}`);
    }
    gl.useProgram(program);
    const places = {};
    const at = (name) => (places[name] ??= gl.getUniformLocation(program, name));
    const unit = (...names) => names.map((name) => data.units[name]);
    gl.uniform1i(at("geometry"), 0);
    gl.uniform1i(at("surface"), 1);
    gl.uniform1i(at(data.lobes ? "lobes" : "bands"), 2);
    if (data.lobes) gl.uniform3fv(at("axes"), data.lobes.axes.flat());
    gl.uniform4fv(at("geometryUnit"), unit("normal_u", "normal_v", "roughness", "facing"));
    gl.uniform4fv(at("surfaceUnit"), unit("red", "green", "blue", "metallic"));
    gl.uniform1f(at("tangent"), data.tangent);
    for (const [i, name] of ["panorama", "hemispheres", "lobeNodes"].entries()) {
      gl.uniform1i(at(name), 3 + i);
    }
    return { program, at };
  }

  /**
   * @param {{sh: ?Float64Array, lamps: Array, environment: ?Object}} light as it is turned now
   * @param state of the view; `exposure` in all
   * @param {number} stride texels from one pixel to the next: 1, or more while a finger waits
   */
  draw(light, state, exposure, stride = 1) {
    const { gl, canvas, data } = this;
    const width = Math.ceil(data.width / stride);
    const height = Math.ceil(data.height / stride);
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const lit = ["relit", "strips"].includes(state.view);
    const kinds = [];
    if (lit && light.sh) kinds.push("sh");
    if (lit && light.lamps.length) kinds.push("lamps");
    if (lit && light.environment) {
      kinds.push("environment");
      this.place(light.environment);
    }
    const { program, at } = this.program(kinds);
    gl.useProgram(program);
    gl.viewport(0, 0, width, height);
    if (kinds.includes("sh")) gl.uniform3fv(at("light"), Float32Array.from(light.sh));
    if (kinds.includes("lamps")) {
      gl.uniform1i(at("lampCount"), light.lamps.length);
      gl.uniform3fv(at("lampDirections"), light.lamps.flatMap(({ direction }) => direction));
      gl.uniform3fv(at("lampColors"), light.lamps.flatMap(({ color }) => color));
      gl.uniform1fv(at("lampExtents"), light.lamps.map(({ extent }) => extent ?? 0));
    }
    if (kinds.includes("environment")) {
      const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
      gl.uniformMatrix3fv(at("toPanorama"), false,
        axes.flatMap((axis) => directionBefore(axis, state.rotate, state.tilt)));
      gl.uniform1f(at("panoramaUnit"), light.environment.unit);
    }
    gl.uniform2f(at("offset"), state.roughness, state.metallic);
    gl.uniform1f(at("gain"), 2 ** exposure);
    gl.uniform1i(at("toneMap"), TONE_MAPS.indexOf(state.tone));
    gl.uniform1i(at("shown"), Math.max(0, SHOWN.indexOf(state.view)));
    gl.uniform1i(at("stride"), stride);
    gl.uniform4fv(at("box"), data.box);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
