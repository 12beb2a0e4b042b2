// Runge-Kutta methods as tables. An explicit method is a struct of constants here and a place in
// one of the lists below; the kernels of ode/ and fields/, the stability functions, the Python
// names and the test suites read it from there. Implicit ones have kernels of their own, and a
// table here.
//
//   k_1 = f(t, y),  k_i = f(t + c_i h, y + h sum_j a_ij k_j),  y_new = y + h sum_i b_i k_i
//
// Rows of a beyond `stages` serve the error estimate and the dense output: row stages + 1 is b
// itself, so that k_{stages+1} = f(t + h, y_new) is the next step's k_1.
//
// [HNW] Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", 2nd ed., 1993.
// [HW] Hairer, Wanner, "Solving Ordinary Differential Equations II", 2nd ed., 1996.
#pragma once

#include <array>
#include <cstddef>
#include <string_view>
#include <tuple>

namespace substep::tableaux {

enum class Estimate {
  doubling,  // none of its own: one step against two of half the length
  radau,     // [HW] IV.8 (8.19)
  embedded,  // h sum e_i k_i, i up to stages + 1
  dop853,    // orders 5 and 3 combined, [HNW] II.10, as in Hairer's code
};

// Explicit Euler, [HNW] I.7.
struct Euler {
  static constexpr std::string_view name = "euler";
  static constexpr int order = 1, stages = 1, all_stages = 1, dense_rows = 0;
  static constexpr Estimate estimate = Estimate::doubling;
  static constexpr double c[1] = {0}, a[1][1] = {{0}}, b[1] = {1};
};

// Explicit midpoint rule (Runge 1895), [HNW] II.1 (1.4).
struct Midpoint {
  static constexpr std::string_view name = "midpoint";
  static constexpr int order = 2, stages = 2, all_stages = 2, dense_rows = 0;
  static constexpr Estimate estimate = Estimate::doubling;
  static constexpr double c[2] = {0, 0.5}, a[2][2] = {{0}, {0.5}}, b[2] = {0, 1};
};

// Heun's method of order 2 (explicit trapezoidal rule), [HNW] II.1.
struct Heun {
  static constexpr std::string_view name = "heun";
  static constexpr int order = 2, stages = 2, all_stages = 2, dense_rows = 0;
  static constexpr Estimate estimate = Estimate::doubling;
  static constexpr double c[2] = {0, 1}, a[2][2] = {{0}, {1}}, b[2] = {0.5, 0.5};
};

// The classical method of Kutta (1901), [HNW] table II.1.2.
struct Rk4 {
  static constexpr std::string_view name = "rk4";
  static constexpr int order = 4, stages = 4, all_stages = 4, dense_rows = 0;
  static constexpr Estimate estimate = Estimate::doubling;
  static constexpr double c[4] = {0, 0.5, 0.5, 1};
  static constexpr double a[4][4] = {{0}, {0.5}, {0, 0.5}, {0, 0, 1}};
  static constexpr double b[4] = {1. / 6, 1. / 3, 1. / 3, 1. / 6};
};

// clang-format off
// Dormand and Prince 5(4), J. Comput. Appl. Math. 6 (1980) 19, [HNW] table II.5.2; dense output of
// order 4 by Shampine, Math. Comp. 46 (1986) 135, in the form of Hairer's DOPRI5.
struct DormandPrince5 {
  static constexpr std::string_view name = "RK45";
  static constexpr int order = 5, stages = 6, all_stages = 7, dense_rows = 1;
  static constexpr Estimate estimate = Estimate::embedded;
  static constexpr int error_order = 4;
  static constexpr double c[7] = {0, 1. / 5, 3. / 10, 4. / 5, 8. / 9, 1, 1};
  static constexpr double a[7][7] = {
    {0},
    {1. / 5},
    {3. / 40, 9. / 40},
    {44. / 45, -56. / 15, 32. / 9},
    {19372. / 6561, -25360. / 2187, 64448. / 6561, -212. / 729},
    {9017. / 3168, -355. / 33, 46732. / 5247, 49. / 176, -5103. / 18656},
    {35. / 384, 0, 500. / 1113, 125. / 192, -2187. / 6784, 11. / 84}};
  static constexpr double b[6] = {35. / 384, 0, 500. / 1113, 125. / 192, -2187. / 6784, 11. / 84};
  static constexpr double e[7] = {-71. / 57600, 0, 71. / 16695, -71. / 1920, 17253. / 339200,
                                  -22. / 525, 1. / 40};
  static constexpr double d[1][7] = {
    {-12715105075. / 11282082432, 0, 87487479700. / 32700410799, -10690763975. / 1880347072,
     701980252875. / 199316789632, -1453857185. / 822651844, 69997945. / 29380423}};
};

// Dormand and Prince 8(5,3) with dense output of order 7, [HNW] II.5 and II.6; the decimals are
// those of Hairer's DOP853.
struct DormandPrince853 {
  static constexpr std::string_view name = "DOP853";
  static constexpr int order = 8, stages = 12, all_stages = 16, dense_rows = 4;
  static constexpr Estimate estimate = Estimate::dop853;
  static constexpr int error_order = 7;
  static constexpr double c[16] = {
      0.0, 0.526001519587677318785587544488e-01, 0.789002279381515978178381316732e-01,
      0.118350341907227396726757197510, 0.281649658092772603273242802490,
      0.333333333333333333333333333333, 0.25, 0.307692307692307692307692307692,
      0.651282051282051282051282051282, 0.6, 0.857142857142857142857142857142, 1.0, 1.0, 0.1, 0.2,
      0.777777777777777777777777777778};
  static constexpr double a[16][16] = {
    {0},
    {5.26001519587677318785587544488e-2},
    {1.97250569845378994544595329183e-2, 5.91751709536136983633785987549e-2},
    {2.95875854768068491816892993775e-2, 0, 8.87627564304205475450678981324e-2},
    {
      2.41365134159266685502369798665e-1, 0, -8.84549479328286085344864962717e-1,
      9.24834003261792003115737966543e-1},
    {
      3.7037037037037037037037037037e-2, 0, 0, 1.70828608729473871279604482173e-1,
      1.25467687566822425016691814123e-1},
    {
      3.7109375e-2, 0, 0, 1.70252211019544039314978060272e-1, 6.02165389804559606850219397283e-2,
      -1.7578125e-2},
    {
      3.70920001185047927108779319836e-2, 0, 0, 1.70383925712239993810214054705e-1,
      1.07262030446373284651809199168e-1, -1.53194377486244017527936158236e-2,
      8.27378916381402288758473766002e-3},
    {
      6.24110958716075717114429577812e-1, 0, 0, -3.36089262944694129406857109825,
      -8.68219346841726006818189891453e-1, 2.75920996994467083049415600797e1,
      2.01540675504778934086186788979e1, -4.34898841810699588477366255144e1},
    {
      4.77662536438264365890433908527e-1, 0, 0, -2.48811461997166764192642586468,
      -5.90290826836842996371446475743e-1, 2.12300514481811942347288949897e1,
      1.52792336328824235832596922938e1, -3.32882109689848629194453265587e1,
      -2.03312017085086261358222928593e-2},
    {
      -9.3714243008598732571704021658e-1, 0, 0, 5.18637242884406370830023853209,
      1.09143734899672957818500254654, -8.14978701074692612513997267357,
      -1.85200656599969598641566180701e1, 2.27394870993505042818970056734e1,
      2.49360555267965238987089396762, -3.0467644718982195003823669022},
    {
      2.27331014751653820792359768449, 0, 0, -1.05344954667372501984066689879e1,
      -2.00087205822486249909675718444, -1.79589318631187989172765950534e1,
      2.79488845294199600508499808837e1, -2.85899827713502369474065508674,
      -8.87285693353062954433549289258, 1.23605671757943030647266201528e1,
      6.43392746015763530355970484046e-1},
    {
      5.42937341165687622380535766363e-2, 0, 0, 0, 0, 4.45031289275240888144113950566,
      1.89151789931450038304281599044, -5.8012039600105847814672114227,
      3.1116436695781989440891606237e-1, -1.52160949662516078556178806805e-1,
      2.01365400804030348374776537501e-1, 4.47106157277725905176885569043e-2},
    {
      5.61675022830479523392909219681e-2, 0, 0, 0, 0, 0, 2.53500210216624811088794765333e-1,
      -2.46239037470802489917441475441e-1, -1.24191423263816360469010140626e-1,
      1.5329179827876569731206322685e-1, 8.20105229563468988491666602057e-3,
      7.56789766054569976138603589584e-3, -8.298e-3},
    {
      3.18346481635021405060768473261e-2, 0, 0, 0, 0, 2.83009096723667755288322961402e-2,
      5.35419883074385676223797384372e-2, -5.49237485713909884646569340306e-2, 0, 0,
      -1.08347328697249322858509316994e-4, 3.82571090835658412954920192323e-4,
      -3.40465008687404560802977114492e-4, 1.41312443674632500278074618366e-1},
    {
      -4.28896301583791923408573538692e-1, 0, 0, 0, 0, -4.69762141536116384314449447206,
      7.68342119606259904184240953878, 4.06898981839711007970213554331,
      3.56727187455281109270669543021e-1, 0, 0, 0, -1.39902416515901462129418009734e-3,
      2.9475147891527723389556272149, -9.15095847217987001081870187138}};
  static constexpr double b[12] = {
      5.42937341165687622380535766363e-2, 0, 0, 0, 0, 4.45031289275240888144113950566,
      1.89151789931450038304281599044, -5.8012039600105847814672114227,
      3.1116436695781989440891606237e-1, -1.52160949662516078556178806805e-1,
      2.01365400804030348374776537501e-1, 4.47106157277725905176885569043e-2};
  // b less the third-order weights bhh: 0.2440944881889764 k1 + 0.7338466882816119 k9 +
  // 0.02205882352941176 k12.
  static constexpr double e3[12] = {
      5.42937341165687622380535766363e-2 - 0.244094488188976377952755905512, 0, 0, 0, 0,
      4.45031289275240888144113950566, 1.89151789931450038304281599044,
      -5.8012039600105847814672114227,
      3.1116436695781989440891606237e-1 - 0.733846688281611857341361741547,
      -1.52160949662516078556178806805e-1, 2.01365400804030348374776537501e-1,
      4.47106157277725905176885569043e-2 - 0.220588235294117647058823529412e-1};
  static constexpr double e5[12] = {
      0.1312004499419488073250102996e-1, 0, 0, 0, 0, -0.1225156446376204440720569753e+1,
      -0.4957589496572501915214079952, 0.1664377182454986536961530415e+1,
      -0.3503288487499736816886487290, 0.3341791187130174790297318841,
      0.8192320648511571246570742613e-1, -0.2235530786388629525884427845e-1};
  static constexpr double d[4][16] = {
    {
      -0.84289382761090128651353491142e+1, 0, 0, 0, 0, 0.56671495351937776962531783590,
      -0.30689499459498916912797304727e+1, 0.23846676565120698287728149680e+1,
      0.21170345824450282767155149946e+1, -0.87139158377797299206789907490,
      0.22404374302607882758541771650e+1, 0.63157877876946881815570249290,
      -0.88990336451333310820698117400e-1, 0.18148505520854727256656404962e+2,
      -0.91946323924783554000451984436e+1, -0.44360363875948939664310572000e+1},
    {
      0.10427508642579134603413151009e+2, 0, 0, 0, 0, 0.24228349177525818288430175319e+3,
      0.16520045171727028198505394887e+3, -0.37454675472269020279518312152e+3,
      -0.22113666853125306036270938578e+2, 0.77334326684722638389603898808e+1,
      -0.30674084731089398182061213626e+2, -0.93321305264302278729567221706e+1,
      0.15697238121770843886131091075e+2, -0.31139403219565177677282850411e+2,
      -0.93529243588444783865713862664e+1, 0.35816841486394083752465898540e+2},
    {
      0.19985053242002433820987653617e+2, 0, 0, 0, 0, -0.38703730874935176555105901742e+3,
      -0.18917813819516756882830838328e+3, 0.52780815920542364900561016686e+3,
      -0.11573902539959630126141871134e+2, 0.68812326946963000169666922661e+1,
      -0.10006050966910838403183860980e+1, 0.77771377980534432092869265740,
      -0.27782057523535084065932004339e+1, -0.60196695231264120758267380846e+2,
      0.84320405506677161018159903784e+2, 0.11992291136182789328035130030e+2},
    {
      -0.25693933462703749003312586129e+2, 0, 0, 0, 0, -0.15418974869023643374053993627e+3,
      -0.23152937917604549567536039109e+3, 0.35763911791061412378285349910e+3,
      0.93405324183624310003907691704e+2, -0.37458323136451633156875139351e+2,
      0.10409964950896230045147246184e+3, 0.29840293426660503123344363579e+2,
      -0.43533456590011143754432175058e+2, 0.96324553959188282948394950600e+2,
      -0.39177261675615439165231486172e+2, -0.14972683625798562581422125276e+3}};
};
// clang-format on

// Implicit Euler, [HW] IV.1 (1.8).
struct ImplicitEuler {
  static constexpr std::string_view name = "implicit_euler";
  static constexpr int order = 1, stages = 1, all_stages = 1, dense_rows = 0;
  static constexpr Estimate estimate = Estimate::doubling;
  static constexpr double c[1] = {1}, a[1][1] = {{1}}, b[1] = {1};
};

// Radau IIA of order 5, [HW] table IV.5.6; sqrt(6) = 2.449489742783178098.
struct RadauIIA5 {
  static constexpr std::string_view name = "Radau";
  static constexpr int order = 5, stages = 3, all_stages = 3, dense_rows = 0;
  static constexpr Estimate estimate = Estimate::radau;
  static constexpr int error_order = 3;
  static constexpr double s6 = 2.449489742783178098197;
  static constexpr double c[3] = {(4 - s6) / 10, (4 + s6) / 10, 1};
  static constexpr double a[3][3] = {
      {(88 - 7 * s6) / 360, (296 - 169 * s6) / 1800, (-2 + 3 * s6) / 225},
      {(296 + 169 * s6) / 1800, (88 + 7 * s6) / 360, (-2 - 3 * s6) / 225},
      {(16 - s6) / 36, (16 + s6) / 36, 1. / 9}};
  static constexpr double b[3] = {(16 - s6) / 36, (16 + s6) / 36, 1. / 9};
};

// In rising order of accuracy. Those without an estimate move particles through fields too, and are
// fused with the large systems of ode/.
using FixedMethods = std::tuple<Euler, Midpoint, Heun, Rk4>;
using Pairs = std::tuple<DormandPrince5, DormandPrince853>;
using Methods = decltype(std::tuple_cat(FixedMethods{}, Pairs{}));

using ImplicitMethods = std::tuple<ImplicitEuler, RadauIIA5>;

constexpr double nearest_whole(double x) {
  return static_cast<double>(static_cast<long>(x < 0 ? x - 0.5 : x + 0.5));
}

// b as whole numbers over their sum: the smallest divisor up to 1000 that makes all of them whole.
// Where there is none: b itself, over 1.
template <class T>
struct WholeWeights {
  static constexpr int divisor = [] {
    for (int n = 1; n <= 1000; ++n) {
      bool whole = true;
      for (const double b : T::b) {
        const double error = b * n - nearest_whole(b * n);
        whole = whole && error < 1e-12 && error > -1e-12;
      }
      if (whole) return n;
    }
    return 1;
  }();
  static constexpr std::array<double, T::stages> b = [] {
    std::array<double, T::stages> weights{};
    for (std::size_t i = 0; i < weights.size(); ++i) {
      weights[i] = divisor == 1 ? T::b[i] : nearest_whole(T::b[i] * divisor);
    }
    return weights;
  }();
};

// Calls action(table) for each method of a list.
template <class List, class Action>
void for_each_method(Action&& action) {
  std::apply([&](const auto&... table) { (action(table), ...); }, List{});
}

}  // namespace substep::tableaux
