/* The yardstick of `sitl bench campaign`: the paper's law (11), (14) for phi = 1/2 k |x - r|^2, the exact step
 * of the kinematic body (1) and the helix of section 4, written by hand for speed in plain C and double
 * precision. It is not part of the system: it says how fast this arithmetic can be on the machine at hand.
 *
 * NED, metres; attitude is a unit quaternion, scalar first, body to world. Rates and speed are bounded as the
 * campaign bounds them, and it looks at the same outcomes. No lags, no delay, no wind.
 *
 * Built by the benchmark:  cc -O3 -march=native -shared -fPIC -pthread bench_campaign.c -lm
 */
#include <math.h>
#include <pthread.h>
#include <stddef.h>

typedef struct {
    double radius_m, speed_m_s, down_m_s;       /* helix */
    double k, rho2, rho3, beta;                 /* gains */
    double speed_min_m_s, speed_max_m_s, rate_max_rad_s;
    double dt_s, within_m;
    long steps;
} plan_t;

static const double RATIO_MIN = 0.05; /* the named branch at y4 = 0, as a sine */

static inline double clamp(double v, double low, double high) { return v < low ? low : v > high ? high : v; }

/* start: x y z qw qx qy qz, and the time on the helix. outcome: see OUTCOMES below; times in steps, -1 for never. */
enum { ENTERED, SETTLED, FINAL, EXCURSION, RMS, Y4_MIN, SINGULAR, SATURATED, REVERSE, OUTCOMES };

static void fly(const plan_t *p, const double *start, double *outcome)
{
    double x = start[0], y = start[1], z = start[2];
    double qw = start[3], qx = start[4], qy = start[5], qz = start[6];
    const double w = p->speed_m_s / p->radius_m;
    const double lambda = 1.0 / p->beta, lk = lambda * p->k;
    const double turn_most = (p->rho2 > p->rho3 ? p->rho2 : p->rho3) / RATIO_MIN;
    const double within2 = p->within_m * p->within_m;
    const long tail = p->steps - p->steps / 4;
    long entered = -1, last_out = -1, singular = 0, saturated = 0, reverse = 0;
    double excursion2 = 0.0, sum2 = 0.0, y4_min = INFINITY, e2 = 0.0;
    for (long n = 0;; n++) {
        const double t = start[7] + n * p->dt_s;
        const double s = sin(w * t), c = cos(w * t);
        const double ex = x - p->radius_m * s, ey = y - p->radius_m * c, ez = z - p->down_m_s * t;
        const double vx = p->speed_m_s * c, vy = -p->speed_m_s * s, vz = p->down_m_s;
        /* Xr = r' - lambda k e,  a = r'' + lambda k r' */
        const double Fx = vx - lk * ex, Fy = vy - lk * ey, Fz = vz - lk * ez;
        const double ax = -p->speed_m_s * w * s + lk * vx, ay = -p->speed_m_s * w * c + lk * vy, az = lk * vz;
        e2 = ex * ex + ey * ey + ez * ez;
        if (!(e2 < within2))
            last_out = n;
        else if (entered < 0)
            entered = n;
        if (entered >= 0 && e2 > excursion2)
            excursion2 = e2;
        if (n >= tail)
            sum2 += e2;

        /* columns of R */
        const double b1x = 1 - 2 * (qy * qy + qz * qz), b1y = 2 * (qx * qy + qw * qz), b1z = 2 * (qx * qz - qw * qy);
        const double b2x = 2 * (qx * qy - qw * qz), b2y = 1 - 2 * (qx * qx + qz * qz), b2z = 2 * (qy * qz + qw * qx);
        const double b3x = 2 * (qx * qz + qw * qy), b3y = 2 * (qy * qz - qw * qx), b3z = 1 - 2 * (qx * qx + qy * qy);
        const double y4 = p->beta * (b1x * Fx + b1y * Fy + b1z * Fz);
        const double y5 = p->beta * (b2x * Fx + b2y * Fy + b2z * Fz);
        const double y6 = p->beta * (b3x * Fx + b3y * Fy + b3z * Fz);
        double turn5 = p->rho3 * y5, turn6 = p->rho2 * y6, divisor = y4;
        const double least = RATIO_MIN * sqrt(y4 * y4 + y5 * y5 + y6 * y6);
        double u2 = 0.0, u3 = 0.0;
        int at_branch = 1;
        if (least > 0.0) {
            if (fabs(y4) <= least) {
                divisor = least;
            } else {
                at_branch = 0;
                turn5 += p->beta * (b2x * ax + b2y * ay + b2z * az);
                turn6 += p->beta * (b3x * ax + b3y * ay + b3z * az);
            }
            const double turn2 = turn5 * turn5 + turn6 * turn6, most = turn_most * fabs(divisor);
            double factor = 1.0 / divisor;
            if (turn2 > most * most) {
                at_branch = 1;
                factor *= most / sqrt(turn2);
            }
            u2 = -turn6 * factor;
            u3 = turn5 * factor;
        }
        const double v2 = clamp(u2, -p->rate_max_rad_s, p->rate_max_rad_s);
        const double v3 = clamp(u3, -p->rate_max_rad_s, p->rate_max_rad_s);
        const double v4 = clamp(lambda * y4, p->speed_min_m_s, p->speed_max_m_s);
        y4_min = y4 < y4_min ? y4 : y4_min;
        singular += at_branch;
        saturated += v2 != u2 || v3 != u3 || v4 != lambda * y4;
        reverse += v4 < 0.0;
        if (n == p->steps)
            break;

        /* pose times exp of the twist times dt, for u1 = 0 */
        const double ty = v2 * p->dt_s, tz = v3 * p->dt_s, d = v4 * p->dt_s;
        const double angle2 = ty * ty + tz * tz;
        double cosine, half_sinc, c1, c2;
        if (angle2 < 1e-4) {
            c1 = 0.5 - angle2 * (1.0 / 24.0 - angle2 * (1.0 / 720.0));
            c2 = 1.0 / 6.0 - angle2 * (1.0 / 120.0 - angle2 * (1.0 / 5040.0));
            half_sinc = 0.5 - angle2 * (1.0 / 48.0 - angle2 * (1.0 / 3840.0));
            cosine = 1.0 - angle2 * (0.125 - angle2 * (1.0 / 384.0));
        } else {
            const double angle = sqrt(angle2), sine = sin(0.5 * angle);
            cosine = cos(0.5 * angle);
            half_sinc = sine / angle;
            c1 = 2.0 * half_sinc * half_sinc;
            c2 = (angle - 2.0 * sine * cosine) / (angle2 * angle);
        }
        /* turn x d b1 = (0, tz d, -ty d); turn x that = (-(ty^2 + tz^2) d, 0, 0) */
        const double bx = d - c2 * angle2 * d, by = c1 * tz * d, bz = -c1 * ty * d;
        x += b1x * bx + b2x * by + b3x * bz;
        y += b1y * bx + b2y * by + b3y * bz;
        z += b1z * bx + b2z * by + b3z * bz;
        const double ky = half_sinc * ty, kz = half_sinc * tz;
        const double pw = qw * cosine - qy * ky - qz * kz;
        const double px = qx * cosine + qy * kz - qz * ky;
        const double py = qy * cosine + qw * ky - qx * kz;
        const double pz = qz * cosine + qw * kz + qx * ky;
        const double unit = 1.0 / sqrt(pw * pw + px * px + py * py + pz * pz);
        qw = pw * unit, qx = px * unit, qy = py * unit, qz = pz * unit;
    }
    outcome[ENTERED] = entered;
    outcome[SETTLED] = last_out < p->steps ? last_out + 1 : -1;
    outcome[FINAL] = sqrt(e2);
    outcome[EXCURSION] = sqrt(excursion2);
    outcome[RMS] = sqrt(sum2 / (p->steps + 1 - tail));
    outcome[Y4_MIN] = y4_min;
    outcome[SINGULAR] = singular;
    outcome[SATURATED] = saturated;
    outcome[REVERSE] = reverse;
}

typedef struct {
    const plan_t *plan;
    const double *starts;
    double *outcomes;
    long first, count, stride;
} share_t;

static void *fly_share(void *argument)
{
    const share_t *share = argument;
    for (long i = share->first; i < share->count; i += share->stride)
        fly(share->plan, share->starts + 8 * i, share->outcomes + OUTCOMES * i);
    return NULL;
}

/* Flies `count` flights on `threads` (at most 256) threads; 0 if all went well. */
int fly_all(const plan_t *plan, const double *starts, double *outcomes, long count, long threads)
{
    pthread_t ids[256];
    share_t shares[256];
    long started = 0;
    int failed = 0;
    if (threads < 1 || threads > 256)
        return 1;
    for (; started < threads; started++) {
        shares[started] = (share_t){plan, starts, outcomes, started, count, threads};
        if (pthread_create(&ids[started], NULL, fly_share, &shares[started])) {
            failed = 1;
            break;
        }
    }
    for (long i = 0; i < started; i++)
        failed |= pthread_join(ids[i], NULL) != 0;
    return failed;
}
