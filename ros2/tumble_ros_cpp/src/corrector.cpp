// sensor_msgs/Imu in, corrected sensor_msgs/Imu out, by the functions of the header that `tumble export --to c` writes: at the
// reference temperature, without lever arms. Topics: imu/data_raw -> imu/data_corrected.
#include <memory>
#include <type_traits>
#include <utility>

#include "rclcpp/rclcpp.hpp"
#include "rclcpp_components/register_node_macro.hpp"
#include "sensor_msgs/msg/imu.hpp"

#include TUMBLE_CALIBRATION

namespace tumble
{

/// The rate of readings of gyros, which feel the force where the header has a g-sensitivity, and else do not.
template<class Function>
void rate_of(Function correct, const double reading[3], const double force[3], double out[3])
{
  if constexpr (std::is_invocable_v<Function, const double *, const double *, double *>) {
    correct(reading, force, out);
  } else {
    correct(reading, out);
  }
}

class Corrector : public rclcpp::Node
{
public:
  using Imu = sensor_msgs::msg::Imu;

  explicit Corrector(const rclcpp::NodeOptions & options)
  : Node("tumble_corrector", options)
  {
    out_ = create_publisher<Imu>("imu/data_corrected", rclcpp::SensorDataQoS());
    in_ = create_subscription<Imu>(
      "imu/data_raw", rclcpp::SensorDataQoS(), [this](Imu::UniquePtr message) {
        auto & a = message->linear_acceleration;
        auto & w = message->angular_velocity;
        const double accel[3] = {a.x, a.y, a.z}, gyro[3] = {w.x, w.y, w.z};
        double force[3], rate[3];
        imu_correct_accel(accel, force);
        rate_of(&imu_correct_gyro, gyro, force, rate);
        a.x = force[0], a.y = force[1], a.z = force[2];
        w.x = rate[0], w.y = rate[1], w.z = rate[2];
        out_->publish(std::move(message));
      });
  }

private:
  rclcpp::Publisher<Imu>::SharedPtr out_;
  rclcpp::Subscription<Imu>::SharedPtr in_;
};

}  // namespace tumble

RCLCPP_COMPONENTS_REGISTER_NODE(tumble::Corrector)
