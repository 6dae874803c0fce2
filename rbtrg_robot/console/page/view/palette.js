// Colours of what is drawn, 0 to 255. Lines have a casing on either side, which sets them off from whatever ground is below.

// Of each theme: `ramp` low, middle, high ground; `shade` of a face turned away and how much light adds; `doubt` is mixed into ground that is
// not trusted; `grid` lines every metre, and how much of them is seen. The light one is for sunlight: grid and lines stand 7 to 1.
export const THEMES = {
  light: {
    ramp: [[206, 221, 224], [230, 232, 217], [250, 237, 214]], // prettier-ignore
    shade: [0.84, 0.2],
    doubt: [255, 255, 255],
    grid: [[23, 33, 43], 1],
    sky: [223, 230, 234],
    casing: [255, 255, 255, 255],
    step: [0, 84, 78, 255],
    done: [72, 82, 90, 255],
    robot: [62, 78, 92, 255],
    dark: [23, 33, 43, 255],
    route: [0, 56, 132, 255],
    preview: [112, 0, 140, 255],
    native: [60, 66, 74, 255],
    goal: [140, 52, 0, 255],
    home: [0, 88, 38, 255],
    worst: [158, 0, 0, 255],
    chosen: [96, 70, 0, 255],
    allowed: [0, 88, 38, 255],
    drawn: [112, 0, 140, 255],
  },
  dark: {
    ramp: [[102, 135, 140], [168, 173, 143], [219, 191, 148]], // prettier-ignore
    shade: [0.55, 0.5],
    doubt: [115, 115, 115],
    grid: [[10, 16, 22], 0.25],
    sky: [29, 38, 45],
    casing: [10, 16, 22, 255],
    step: [80, 220, 205, 255],
    done: [165, 178, 186, 255],
    robot: [245, 250, 255, 255],
    dark: [38, 50, 60, 255],
    route: [92, 190, 255, 255],
    preview: [226, 150, 255, 255],
    native: [190, 198, 206, 255],
    goal: [255, 160, 40, 255],
    home: [90, 220, 130, 255],
    worst: [255, 140, 130, 255],
    chosen: [255, 208, 40, 255],
    allowed: [90, 220, 130, 255],
    drawn: [226, 150, 255, 255],
  },
};

export const COLOUR = { ...THEMES.light };
export const wear = (name) => Object.assign(COLOUR, THEMES[name]);
export const parts = (colour) => colour.slice(0, 3).map((v) => v / 255);
