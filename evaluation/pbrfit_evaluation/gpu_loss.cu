// One evaluation of loss and gradient: gpu_loss.py has the formulas, and puts PICTURES, TERMS, F0,
// SCALE (2 over the number of samples) and POLYNOMIALS (of the band weights) before this.
//
// maps (5, P), diffuses (9, P), mirrors (16, P), cosines (P), targets (3, N, P), lights (3, N, 16);
// out: by_maps (5, P); by_lights (blocks, 3, N, 16) and losses (blocks), still to be summed.

constexpr float INV_PI = .3183098861837907f;
constexpr int T = 128, STRIDE = T + 4, CHUNKS = (PICTURES + 15) / 16;

extern "C" __global__ void __launch_bounds__(T) loss(
    const float* maps, const float* diffuses, const float* mirrors, const float* cosines,
    const float* targets, const float* lights, float* by_maps, float* by_lights,
    float* losses, int pixels)
{
    __shared__ __align__(16) float light[3][CHUNKS * 16][16];
    __shared__ __align__(16) float errors[16][STRIDE], weights[16][STRIDE];
    const int t = threadIdx.x, row = t & 3, column = (t >> 2) & 3, group = t >> 4;
    for (int i = t; i < 3 * CHUNKS * 256; i += T) {
        const int c = i / (CHUNKS * 256), n = i / 16 % (CHUNKS * 16);
        light[c][n][i % 16] = n < PICTURES ? lights[(c * PICTURES + n) * 16 + i % 16] : 0.f;
    }
    __syncthreads();
    float sums[3][CHUNKS][16] = {};
    float total = 0.f;
    for (int start = blockIdx.x * T; start < pixels; start += gridDim.x * T) {
        const int p = start + t;
        const bool inside = p < pixels;
        const int q = inside ? p : pixels - 1;
        float mirror[16], diffuse[9];
        for (int k = 0; k < 16; k++) mirror[k] = inside ? mirrors[k * pixels + q] : 0.f;
        for (int k = 0; k < 9; k++) diffuse[k] = inside ? diffuses[k * pixels + q] : 0.f;
        const float r = maps[3 * pixels + q], m = maps[4 * pixels + q], x = cosines[q];
        const float s = 2 * r - 1;
        float h[4], dh[4];
        for (int l = 0; l < 4; l++) {
            float value = POLYNOMIALS[l][TERMS - 1], slope = 0.f;
            for (int j = TERMS - 2; j >= 0; j--) {
                slope = slope * s + value;
                value = value * s + POLYNOMIALS[l][j];
            }
            h[l] = value;
            dh[l] = 2 * slope;
        }
        const float r3 = r * r * r, half = .5f * r3 * r, inverse = 1 / (x * (1 - half) + half);
        const float g1 = .25f * x * inverse, dg1 = -.5f * x * (1 - x) * inverse * inverse * r3;
        const float y = 1 - x, transmission = 1 - y * y * y * y * y;
        const float dielectric = (1 - m) * INV_PI;
        float by_r = 0.f, by_m = 0.f;
        #pragma unroll
        for (int c = 0; c < 3; c++) {
            const float rho = maps[c * pixels + q], f0 = F0 + m * (rho - F0);
            const float fresnel = 1 - (1 - f0) * transmission, ks = fresnel * g1;
            const float kd = (1 - fresnel) * dielectric * rho;
            float w[16], by_w[16] = {};
            for (int k = 0; k < 16; k++) {
                const int l = k < 1 ? 0 : k < 4 ? 1 : k < 9 ? 2 : 3;
                w[k] = ks * h[l] * mirror[k] + (k < 9 ? kd * diffuse[k < 9 ? k : 0] : 0.f);
                weights[k][t] = w[k];
            }
            #pragma unroll
            for (int chunk = 0; chunk < CHUNKS; chunk++) {
                #pragma unroll
                for (int i = 0; i < 16; i++) {
                    const int n = 16 * chunk + i;
                    float e = 0.f;
                    if (n < PICTURES) {
                        const float target = targets[(c * PICTURES + n) * pixels + q];
                        const float4* row4 = reinterpret_cast<const float4*>(light[c][n]);
                        float L[16];
                        for (int k = 0; k < 4; k++) {
                            const float4 four = row4[k];
                            L[4 * k] = four.x, L[4 * k + 1] = four.y;
                            L[4 * k + 2] = four.z, L[4 * k + 3] = four.w;
                        }
                        float e0 = -target, e1 = 0.f;
                        for (int k = 0; k < 16; k += 2) e0 += L[k] * w[k], e1 += L[k + 1] * w[k + 1];
                        e = inside ? e0 + e1 : 0.f;
                        for (int k = 0; k < 16; k++) by_w[k] += L[k] * e;
                    }
                    errors[i][t] = e;
                    total += e * e;
                }
                __syncthreads();
                for (int at = 16 * group; at < 16 * group + 16; at += 4) {
                    float4 e4[4], w4[4];
                    for (int i = 0; i < 4; i++) {
                        e4[i] = *reinterpret_cast<const float4*>(&errors[row + 4 * i][at]);
                        w4[i] = *reinterpret_cast<const float4*>(&weights[column + 4 * i][at]);
                    }
                    for (int i = 0; i < 4; i++)
                        for (int k = 0; k < 4; k++)
                            sums[c][chunk][4 * i + k] += e4[i].x * w4[k].x + e4[i].y * w4[k].y
                                + e4[i].z * w4[k].z + e4[i].w * w4[k].w;
                }
                __syncthreads();
            }
            float by_kd = 0.f, band[4] = {};
            for (int k = 0; k < 9; k++) by_kd += by_w[k] * diffuse[k];
            for (int k = 0; k < 16; k++) band[k < 1 ? 0 : k < 4 ? 1 : k < 9 ? 2 : 3] += by_w[k] * mirror[k];
            float by_ks = 0.f, by_h = 0.f;
            for (int l = 0; l < 4; l++) by_ks += h[l] * band[l], by_h += dh[l] * band[l];
            const float transmitted = (1 - fresnel) * by_kd;
            const float by_f0 = transmission * (g1 * by_ks - dielectric * rho * by_kd);
            by_r += ks * by_h + fresnel * dg1 * by_ks;
            by_m += (rho - F0) * by_f0 - rho * transmitted * INV_PI;
            if (inside) by_maps[c * pixels + p] = SCALE * (dielectric * transmitted + m * by_f0);
        }
        if (inside) by_maps[3 * pixels + p] = SCALE * by_r, by_maps[4 * pixels + p] = SCALE * by_m;
    }
    float* flat = &errors[0][0];
    for (int c = 0; c < 3; c++)
        for (int chunk = 0; chunk < CHUNKS; chunk++) {
            __syncthreads();
            for (int i = 0; i < 4; i++)
                for (int k = 0; k < 4; k++)
                    flat[group * 256 + (row + 4 * i) * 16 + column + 4 * k] = sums[c][chunk][4 * i + k];
            __syncthreads();
            for (int j = t; j < 256; j += T) {
                const int n = 16 * chunk + j / 16;
                float sum = 0.f;
                for (int g = 0; g < 8; g++) sum += flat[g * 256 + j];
                if (n < PICTURES)
                    by_lights[((blockIdx.x * 3 + c) * PICTURES + n) * 16 + j % 16] = SCALE * sum;
            }
        }
    __syncthreads();
    flat[t] = total;
    __syncthreads();
    for (int width = T / 2; width; width /= 2) {
        if (t < width) flat[t] += flat[t + width];
        __syncthreads();
    }
    if (t == 0) losses[blockIdx.x] = .5f * SCALE * flat[0];
}
