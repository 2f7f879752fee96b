// Plays a sequence of noisy frames and denoises each on the graphics card, with passes that lobewise exported.
//
// `Chain` runs any exported chain of compute passes from its chain.json and its files: copy it. The rest is this page.
// sequence.js and passes.js hold files as text, because a page without a server may not read other files.

"use strict";

const FRAMES_PER_SECOND = 8;
const LAST_FRAME_SECONDS = 1.5;

// A chain of compute passes on a device.
class Chain {
  // told: the contents of chain.json. texts: the contents of its files, by name. values: numbers by the names of
  // constants, as far as images have sizes by them.
  constructor(device, told, texts, values) {
    this.device = device;
    this.told = told;
    this.values = values;
    this.number = 0; // frames that have run
    this.textures = new Map();
    const usage = GPUTextureUsage;
    for (const image of told.images) {
      if (image.lifetime === "before") continue;
      const kept = told.images.some((other) => other.before === image.name);
      const given = image.lifetime === "given";
      const make = () => device.createTexture({
        size: [values[image.width], values[image.height]],
        format: given ? "rgba32float" : image.format,
        usage: usage.TEXTURE_BINDING | usage.COPY_SRC | (given ? usage.COPY_DST : usage.STORAGE_BINDING),
      });
      this.textures.set(image.name, kept ? [make(), make()] : [make()]);
    }
    this.block = device.createBuffer({
      size: told.constants.bytes,
      usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST,
    });
    this.pipelines = told.passes.map((pass) => device.createComputePipeline({
      label: pass.name,
      layout: "auto",
      compute: { module: device.createShaderModule({ label: pass.file, code: texts[pass.file] }), entryPoint: pass.entry },
    }));
    // Two sets of groups: images that are kept change places after every frame.
    this.groups = [0, 1].map((parity) => told.passes.map((pass, k) => this.bind(pass, this.pipelines[k], parity)));
  }

  // The texture of an image in frames of a parity.
  find(name, parity) {
    const image = this.told.images.find((each) => each.name === name);
    if (image.before) return this.textures.get(image.before)[1 - parity];
    const pair = this.textures.get(name);
    return pair[pair.length > 1 ? parity : 0];
  }

  bind(pass, pipeline, parity) {
    const entries = [{ binding: 0, resource: { buffer: this.block } }];
    for (const each of pass.bindings) {
      entries.push({ binding: each.binding, resource: this.find(each.image, parity).createView() });
    }
    return this.device.createBindGroup({ layout: pipeline.getBindGroupLayout(0), entries });
  }

  // Runs all passes on a frame. images: four floats for each pixel, by the names of given images. block: the bytes of
  // the constants. The result is in result().
  run(images, block) {
    const queue = this.device.queue;
    queue.writeBuffer(this.block, 0, block);
    for (const image of this.told.images) {
      if (image.lifetime !== "given") continue;
      const size = [this.values[image.width], this.values[image.height]];
      const layout = { bytesPerRow: 16 * size[0], rowsPerImage: size[1] };
      queue.writeTexture({ texture: this.find(image.name, 0) }, images[image.name], layout, size);
    }
    const encoder = this.device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    this.told.passes.forEach((each, k) => {
      pass.setPipeline(this.pipelines[k]);
      pass.setBindGroup(0, this.groups[this.number % 2][k]);
      pass.dispatchWorkgroups(...each.dispatch.map((text) => this.count(text)));
    });
    pass.end();
    queue.submit([encoder.finish()]);
    this.number += 1;
  }

  // The number of workgroups: "1", or "ceil(width / 8)" with the name of a constant.
  count(text) {
    const found = /^ceil\((\w+) \/ (\d+)\)$/.exec(text);
    return found ? Math.ceil(this.values[found[1]] / Number(found[2])) : Number(text);
  }

  // The texture of the result. It is the same in every frame.
  result() {
    return this.find(this.told.images.find((image) => image.lifetime === "result").name, 0);
  }
}

function decodeBase64(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

async function unzip(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// The number of every half float.
function makeHalfTable() {
  return Float32Array.from({ length: 1 << 16 }, (_, bits) => {
    const sign = bits >> 15 ? -1 : 1, exponent = (bits >> 10) & 31, mantissa = bits & 1023;
    if (exponent === 31) return mantissa ? NaN : sign * Infinity;
    return exponent ? sign * 2 ** (exponent - 15) * (1 + mantissa / 1024) : sign * 2 ** -24 * mantissa;
  });
}

// Reads a bundle: a header, and for each frame one plane for each channel, high bytes before low bytes.
function readFrames(data) {
  const length = new DataView(data.buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(data.subarray(4, 4 + length)));
  const { width, height } = header, count = width * height, halves = makeHalfTable();
  let at = 4 + length;
  const readPlane = (isSmooth) => {
    const plane = new Float32Array(count);
    for (let y = 0, k = 0; y < height; y++) {
      for (let x = 0, bits = 0; x < width; x++, k++) {
        const read = data[at + k] << 8 | data[at + count + k];
        bits = isSmooth ? (bits + read) & 65535 : read;
        plane[k] = halves[bits];
      }
    }
    at += 2 * count;
    return plane;
  };
  const frames = header.cameras.map((camera) => {
    const images = {};
    for (const [name, channels, isSmooth] of header.channels) {
      images[name] = Array.from({ length: channels }, () => readPlane(isSmooth));
    }
    return giveImages(images, findPositions(camera, images.depth[0], width, height));
  });
  return { width, height, frames };
}

// Positions in world space, from distances along the rays of a camera.
function findPositions(camera, depth, width, height) {
  const planes = [0, 1, 2].map(() => new Float32Array(width * height));
  for (let y = 0, k = 0; y < height; y++) {
    for (let x = 0; x < width; x++, k++) {
      const right = ((x + 0.5) / width * 2 - 1) * camera.half_extent[0];
      const up = (1 - (y + 0.5) / height * 2) * camera.half_extent[1];
      const ray = camera.forward.map((value, c) => value + right * camera.right[c] + up * camera.up[c]);
      const scale = depth[k] / Math.hypot(...ray);
      for (let c = 0; c < 3; c++) planes[c][k] = camera.position[c] + scale * ray[c];
    }
  }
  return planes;
}

// The images that a chain is given, four floats for each pixel.
function giveImages(images, position) {
  const join = (...planes) => {
    const joined = new Float32Array(4 * planes[0].length);
    planes.forEach((plane, c) => plane.forEach((value, k) => { joined[4 * k + c] = value; }));
    return joined;
  };
  return {
    surface: join(...images.normal, ...images.alpha),
    place: join(...position, ...images.depth),
    motion: join(...images.motion),
    hits: join(...images.hits),
    diffuse: join(...images.diffuse),
    specular: join(...images.specular),
    diffuse_albedo: join(...images.diffuse_albedo),
    specular_albedo: join(...images.specular_albedo),
    emission: join(...images.emission),
  };
}

// The images of a frame of which one pixel in every block is shaded, at a row and column of the block.
function takeSamples(images, size, scale, place) {
  const taken = { ...images };
  for (const name of ["diffuse", "specular"]) {
    taken[name] = new Float32Array(4 * size.columns * size.rows);
    for (let y = 0, k = 0; y < size.rows; y++) {
      for (let x = 0; x < size.columns; x++, k += 4) {
        const from = 4 * ((y * scale + place[0]) * size.width + x * scale + place[1]);
        taken[name].set(images[name].subarray(from, from + 4), k);
      }
    }
  }
  return taken;
}

// Draws the noisy frame and the result of a chain on a canvas.
class Screen {
  constructor(device, canvas, code) {
    this.device = device;
    this.context = canvas.getContext("webgpu");
    const format = navigator.gpu.getPreferredCanvasFormat();
    this.context.configure({ device, format });
    const module = device.createShaderModule({ code });
    this.pipeline = device.createRenderPipeline({
      layout: "auto",
      vertex: { module, entryPoint: "cover" },
      fragment: { module, entryPoint: "show", targets: [{ format }] },
    });
    this.block = device.createBuffer({ size: 16, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
  }

  draw(chain, line) {
    this.device.queue.writeBuffer(this.block, 0, new Float32Array([line, 0, 0, 0]));
    const names = ["diffuse", "specular", "emission"];
    const textures = [...names.map((name) => chain.find(name, 0)), chain.result()];
    const group = this.device.createBindGroup({
      layout: this.pipeline.getBindGroupLayout(0),
      entries: [
        { binding: 0, resource: { buffer: this.block } },
        ...textures.map((texture, k) => ({ binding: 1 + k, resource: texture.createView() })),
      ],
    });
    const encoder = this.device.createCommandEncoder();
    const view = this.context.getCurrentTexture().createView();
    const pass = encoder.beginRenderPass({ colorAttachments: [{ view, loadOp: "clear", storeOp: "store" }] });
    pass.setPipeline(this.pipeline);
    pass.setBindGroup(0, group);
    pass.draw(3);
    pass.end();
    this.device.queue.submit([encoder.finish()]);
  }
}

// Copies a texture of four floats for each pixel to the processor.
async function readTexture(device, texture) {
  const row = Math.ceil(16 * texture.width / 256) * 256;
  const usage = GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ;
  const buffer = device.createBuffer({ size: row * texture.height, usage });
  const encoder = device.createCommandEncoder();
  encoder.copyTextureToBuffer({ texture }, { buffer, bytesPerRow: row }, [texture.width, texture.height]);
  device.queue.submit([encoder.finish()]);
  await buffer.mapAsync(GPUMapMode.READ);
  const padded = new Float32Array(buffer.getMappedRange());
  const image = new Float32Array(4 * texture.width * texture.height);
  for (let y = 0; y < texture.height; y++) {
    image.set(padded.subarray(y * row / 4, y * row / 4 + 4 * texture.width), y * 4 * texture.width);
  }
  buffer.destroy();
  return image;
}

// Returns a device, or throws an error with a sentence for the reader.
async function openDevice() {
  if (!navigator.gpu) {
    throw new Error("This browser has no WebGPU, which runs the passes. Open the page in a current version of Chrome, "
      + "Edge, Safari or Firefox.");
  }
  const adapter = await navigator.gpu.requestAdapter();
  if (!adapter) {
    throw new Error("This browser has WebGPU, but finds no graphics card that it may use. Its settings may forbid it.");
  }
  const device = await adapter.requestDevice();
  device.addEventListener("uncapturederror", (event) => tell(event.error.message));
  device.lost.then((lost) => tell(`The graphics card was lost: ${lost.message} Load the page again.`));
  return device;
}

function tell(sentence) {
  document.getElementById("message").textContent = sentence;
}

// The page: the sequence, the chains, and which frame is shown.
class Page {
  async open() {
    this.device = await openDevice();
    const { width, height, frames } = readFrames(await unzip(decodeBase64(SEQUENCE)));
    this.frames = frames;
    this.chains = PASSES.chains.map((each) => {
      // The size of the image is a multiple of the size of blocks.
      const values = { width, height, columns: width / each.scale, rows: height / each.scale };
      return new Chain(this.device, each.chain, each.files, values);
    });
    this.blocks = PASSES.chains.map((each) => each.blocks.map(decodeBase64));
    this.screen = new Screen(this.device, document.getElementById("picture"), PASSES.show);
    this.chosen = 0;
    this.line = 0.5;
    this.frame = -1;
    this.isPlaying = true;
    this.running = null; // the step that the page plays, if it plays
    this.listen();
    this.play().catch((error) => tell(error.message));
  }

  // Runs the passes on the next frame, shows it, and waits until it is done: a slow graphics card must not get more work
  // than it does. After the last frame the first one follows, without a history.
  async step() {
    this.frame = (this.frame + 1) % this.frames.length;
    const { scale, places } = PASSES.chains[this.chosen], chain = this.chains[this.chosen];
    let images = this.frames[this.frame];
    if (scale > 1) images = takeSamples(images, chain.values, scale, places[this.frame]);
    chain.run(images, this.blocks[this.chosen][this.frame]);
    document.getElementById("frame").textContent = `Frame ${this.frame + 1} of ${this.frames.length}`;
    this.draw();
    await this.device.queue.onSubmittedWorkDone();
  }

  // Runs all frames up to one, from the first on.
  async seek(frame) {
    this.frame = -1;
    while (this.frame < frame) await this.step();
  }

  draw() {
    this.screen.draw(this.chains[this.chosen], this.line);
  }

  // Shows frame after frame while the page is playing.
  async play() {
    for (;;) {
      this.running = this.isPlaying ? this.step() : null;
      await this.running;
      const isLast = this.isPlaying && this.frame === this.frames.length - 1;
      const seconds = isLast ? LAST_FRAME_SECONDS : 1 / FRAMES_PER_SECOND;
      await new Promise((resume) => { setTimeout(resume, 1000 * seconds); });
    }
  }

  setPlaying(isPlaying) {
    this.isPlaying = isPlaying;
    document.getElementById("play").textContent = isPlaying ? "Pause" : "Play";
  }

  setLine(line) {
    this.line = Math.min(Math.max(line, 0), 1);
    document.getElementById("line").value = this.line;
    this.draw();
  }

  // Shows this frame by another chain.
  async choose(number) {
    const isPlaying = this.isPlaying;
    this.setPlaying(false);
    await this.running;
    this.chosen = number;
    await this.seek(this.frame);
    this.setPlaying(isPlaying);
  }

  // The denoised frame, four floats for each pixel, row 0 on top.
  readImage() {
    return readTexture(this.device, this.chains[this.chosen].result());
  }

  listen() {
    const canvas = document.getElementById("picture");
    const drag = (event) => {
      if (event.buttons) this.setLine((event.clientX - canvas.getBoundingClientRect().left) / canvas.clientWidth);
    };
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); drag(event); });
    canvas.addEventListener("pointermove", drag);
    document.getElementById("line").addEventListener("input", (event) => this.setLine(Number(event.target.value)));
    document.getElementById("play").addEventListener("click", () => this.setPlaying(!this.isPlaying));
    const select = document.getElementById("chain");
    PASSES.chains.forEach((each, k) => select.add(new Option(each.title, k)));
    select.addEventListener("change", () => this.choose(Number(select.value)));
  }
}

const page = new Page();
page.opened = page.open().catch((error) => tell(error.message));
