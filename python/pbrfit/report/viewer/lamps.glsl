// Light from single directions, by the model's full reflection: docs/model.md#hard-light. Where a
// model's file has `reflected_lamp`, π f_r (n·l) of a direction, this adds those of all lamps.
const int MOST_LAMPS = 16;
uniform int lampCount;
uniform vec3 lampDirections[MOST_LAMPS];  // to them
uniform vec3 lampColors[MOST_LAMPS];      // irradiance over π
uniform float lampExtents[MOST_LAMPS];    // angular radii of small disks; 0 = points

// D times π. sin θ = |n×h| keeps the digits that 1 − (n·h)² loses.
float distribution(vec3 normal, vec3 bisector, float alpha) {
  vec3 sine = cross(normal, bisector);
  float cosine = dot(normal, bisector);
  float root = alpha / max(dot(sine, sine) + alpha * alpha * cosine * cosine, 1e-14);
  return root * root;
}

float fifth(float x) {
  float square = x * x;
  return square * square * x;
}

// Mean of max(0, n·l) over a disk with this at its middle: rust/lamps/surface.rs.
float mean_cosine(float cosine, float extent) {
  float reach = extent * sqrt(max(1.0 - cosine * cosine, 0.0));
  if (abs(cosine) >= reach) return cosine;
  float x = cosine / reach, root = sqrt(1.0 - x * x);
  return reach * (0.5 * x + (x * x * root + x * asin(x) + root * root * root / 1.5) / PI);
}

// A lobe sees a disk as a point through a wider one.
float widened(float alpha, float extent) {
  return extent > 0.0 ? min(length(vec2(alpha, 0.5 * extent)), 1.0) : alpha;
}
