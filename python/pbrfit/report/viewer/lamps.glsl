// Light from single directions, by the model's full reflection: docs/model.md#hard-light. Where a
// model's file has `reflected_lamp`, π f_r (n·l) of a direction, this adds those of all lamps.
const int MOST_LAMPS = 8;
uniform int lampCount;
uniform vec3 lampDirections[MOST_LAMPS];  // to them
uniform vec3 lampColors[MOST_LAMPS];      // irradiance over π

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
