// The picture: maps as textures, one triangle, relight.frag for each pixel.

const SHOWN = ["relit", "albedo", "roughness", "metallic", "normals"];
const TONE_MAPS = ["none", "neutral"];

class Picture {
  /** @throws Error with a message for the user if there is no WebGL 2, or too little of it */
  constructor(canvas, data, planes, shaders) {
    Object.assign(this, { canvas, data, shaders });
    this.textures = {
      geometry: interleaved([planes.normal_u, planes.normal_v, planes.roughness, planes.facing]),
      surface: interleaved([planes.red, planes.green, planes.blue, planes.metallic]),
    };
    canvas.width = data.width;
    canvas.height = data.height;
    this.gl = canvas.getContext("webgl2", { antialias: false, depth: false });
    if (!this.gl) throw new Error("this browser, or its graphics settings, has no WebGL 2");
    this.prepare();
  }

  /** Program and textures; again after the browser lost them. */
  prepare() {
    const { gl, data, textures } = this;
    const side = Math.max(data.width, data.height);
    if (side > gl.getParameter(gl.MAX_TEXTURE_SIZE)) {
      throw new Error(`the graphics chip takes no maps of ${side} pixels`);
    }
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, this.shaders.vertex],
      [gl.FRAGMENT_SHADER, this.shaders.fragment]]) {
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
    this.at = (name) => gl.getUniformLocation(program, name);

    const integers = [gl.RGBA16UI, gl.RGBA_INTEGER, gl.UNSIGNED_SHORT];
    this.texture(0, "geometry", data.width, data.height, integers, textures.geometry);
    this.texture(1, "surface", data.width, data.height, integers, textures.surface);
    const floats = [gl.RGBA32F, gl.RGBA, gl.FLOAT];
    if (data.lobes) {
      const { axes, width, height, texels } = data.lobes;
      this.texture(2, "lobes", width, height, floats, texels);
      gl.uniform3fv(this.at("axes"), axes.flat());
    } else {
      const bands = Float32Array.from(data.bands);
      this.texture(2, "bands", bands.length / 4, 1, floats, bands);
    }

    const unit = (...names) => names.map((name) => data.units[name]);
    gl.uniform4fv(this.at("geometryUnit"), unit("normal_u", "normal_v", "roughness", "facing"));
    gl.uniform4fv(this.at("surfaceUnit"), unit("red", "green", "blue", "metallic"));
    gl.uniform1f(this.at("tangent"), data.tangent);
  }

  texture(index, name, width, height, [stored, given, type], values) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + index);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    }
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, stored, width, height, 0, given, type, values);
    gl.uniform1i(this.at(name), index);
  }

  /** @param {Float64Array} light as it is turned now */
  draw(light, state) {
    const { gl } = this;
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.uniform3fv(this.at("light"), Float32Array.from(light));
    gl.uniform2f(this.at("offset"), state.roughness, state.metallic);
    gl.uniform1f(this.at("gain"), 2 ** state.exposure);
    gl.uniform1i(this.at("toneMap"), TONE_MAPS.indexOf(state.tone));
    gl.uniform1i(this.at("shown"), SHOWN.indexOf(state.view));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
