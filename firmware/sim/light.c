#include "light.h"

#include <math.h>

/* The flash decays with one time constant, the diode's RC smooths it with the other: A (exp(-t/T1) - exp(-t/T2)),
 * whose integral is proportional to the energy. The amplitude gives a peak of some 600 counts. */
static const double flash_us = 1200.0, diode_us = 700.0, amplitude = 3060.0;

static const double pi = 3.14159265358979323846;

/* xorshift64*, the upper 53 bits, in (0, 1]. */
static double uniform(struct light *light)
{
    uint64_t x = light->random;
    x ^= x >> 12;
    x ^= x << 25;
    x ^= x >> 27;
    light->random = x;
    return (double)(((x * UINT64_C(0x2545F4914F6CDD1D)) >> 11) + 1) / 9007199254740992.0;
}

static double gauss(struct light *light)
{
    const double radius = sqrt(-2.0 * log(uniform(light)));
    return radius * cos(2.0 * pi * uniform(light));
}

double light_fire(struct light *light, double now_us)
{
    if (light->pulse != 0.0 && now_us < light->fired_us + light->recycle_us) {
        return 0.0;
    }
    light->fired_us = now_us;
    light->pulse = fmax(light->energy * (1.0 + light->jitter * gauss(light)), 0.0);
    return light->pulse;
}

uint16_t light_sample(struct light *light, double now_us)
{
    double level = light->dark + light->noise * gauss(light);
    level += light->flicker * sin(2e-6 * pi * light->flicker_hz * now_us);
    const double since = now_us - light->fired_us;
    if (light->pulse != 0.0 && since >= 0.0) {
        level += light->pulse * amplitude * (exp(-since / flash_us) - exp(-since / diode_us));
    }
    return (uint16_t)fmin(fmax(round(level), 0.0), 1023.0);
}
