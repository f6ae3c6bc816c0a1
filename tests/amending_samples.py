"""Small model files with the structure of those of turtlebot3, turtlebot4, husky and jackal."""

from __future__ import annotations

SDF = """<?xml version="1.0" ?>
<sdf version="1.9">
  <model name="small">
    <!-- keep this -->
    <link name="base_link"/>
    <link name="base_scan">
      <sensor name="lds" type="gpu_lidar">
        <pose>-0.032 0 0.171 0 0 0</pose>
        <update_rate>5</update_rate>
        <lidar>
          <scan><horizontal>
            <samples>360</samples>
            <min_angle>0.0</min_angle>
            <max_angle>6.28</max_angle>
          </horizontal></scan>
          <range><min>0.12</min> <max>3.5</max> <resolution>0.015</resolution></range>
        </lidar>
      </sensor>
    </link>
    <link name="wheel_left_link"><collision name="c"><geometry><cylinder><radius>0.033</radius></cylinder></geometry></collision></link>
    <link name="wheel_right_link"><collision name="c"><geometry><cylinder><radius>0.033</radius></cylinder></geometry></collision></link>
    <joint name="left" type="revolute"><parent>base_link</parent><child>wheel_left_link</child></joint>
    <joint name="right" type="revolute"><parent>base_link</parent><child>wheel_right_link</child></joint>
    <plugin filename="gz-sim-diff-drive-system" name="gz::sim::systems::DiffDrive">
      <left_joint>left</left_joint>
      <right_joint>right</right_joint>
      <wheel_separation>0.160</wheel_separation>
      <wheel_radius>0.033</wheel_radius>
    </plugin>
  </model>
</sdf>
"""
CLASSIC = """<sdf version="1.6"><model name="old">
  <link name="base_link">
    <sensor name="front" type="ray"><pose>0.1 0 0.2 0 0 0</pose><ray>
      <range><min>0.1</min><max>10</max></range>
      <noise><type>gaussian</type><mean>0.0</mean><stddev>0.01</stddev></noise>
    </ray></sensor>
    <sensor name="rear" type="ray"><pose>-0.1 0 0.2 0 0 3.14159</pose><ray>
      <range><min>0.1</min><max>10</max></range>
    </ray></sensor>
  </link>
  <plugin name="drive" filename="libgazebo_ros_diff_drive.so">
    <wheel_separation>0.4</wheel_separation>
    <wheel_diameter>0.2</wheel_diameter>
  </plugin>
</model></sdf>
"""
XACRO = """<?xml version="1.0"?>
<robot name="tower" xmlns:xacro="http://ros.org/wiki/xacro">
  <xacro:include filename="$(find tower)/urdf/laser.urdf.xacro"/>
  <xacro:property name="cm2m" value="${1/100.0}"/>
  <xacro:property name="laser_x" value="${-4*cm2m}"/>
  <xacro:property name="laser_y" value="0.0"/>  <!-- centred -->
  <xacro:property name="track" value="0.38"/>
  <xacro:property name="radius" value="0.098"/>
  <xacro:macro name="wheel" params="prefix *joint_pose">
    <link name="${prefix}_wheel"><collision><geometry><cylinder radius="${radius}" length="0.04"/></geometry></collision></link>
    <joint name="${prefix}_wheel_joint" type="continuous">
      <parent link="base_link"/><child link="${prefix}_wheel"/>
      <xacro:insert_block name="joint_pose"/>
    </joint>
  </xacro:macro>
  <link name="base_link"/>
  <xacro:wheel prefix="left"><origin xyz="0 ${track/2} ${radius}"/></xacro:wheel>
  <xacro:wheel prefix="right"><origin xyz="0 ${-track/2} ${radius}"/></xacro:wheel>
  <link name="shell"/>
  <joint name="shell_joint" type="fixed">
    <parent link="base_link"/><child link="shell"/><origin xyz="0 0 0.1" rpy="0 0 ${pi/2}"/>
  </joint>
  <xacro:planar_laser name="front" parent="shell" rate="10">
    <origin xyz="${laser_x} ${laser_y} 0.1" rpy="0 0 ${pi/2}"/>
  </xacro:planar_laser>
</robot>
"""
LASER = """<?xml version="1.0"?>
<robot xmlns:xacro="http://ros.org/wiki/xacro">
  <xacro:macro name="planar_laser" params="name parent rate:=40 r_max:=12.0 *origin">
    <link name="${name}"/>
    <joint name="${name}_joint" type="fixed">
      <parent link="${parent}"/><child link="${name}"/>
      <xacro:insert_block name="origin"/>
    </joint>
    <gazebo reference="${name}"><sensor type="gpu_ray" name="${name}">
      <update_rate>${rate}</update_rate>
      <ray><range><min>0.1</min><max>${r_max}</max></range></ray>
    </sensor></gazebo>
  </xacro:macro>
</robot>
"""
MJCF = """<mujoco model="bot">
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body name="base_link" pos="0 0 0.05">
      <freejoint/>
      <geom type="box" size="0.1 0.1 0.03" mass="3"/>
      <body name="left_wheel" pos="0 0.15 0">
        <joint name="left" type="hinge" axis="0 1 0"/>
        <geom type="cylinder" size="0.05 0.01" euler="1.5708 0 0"/>
      </body>
      <body name="right_wheel" pos="0 -0.15 0">
        <joint name="right" type="hinge" axis="0 1 0"/>
        <geom type="cylinder" size="0.05 0.01" euler="1.5708 0 0"/>
      </body>
      <body name="laser" pos="0.1 0 0.1">  <!-- on top -->
        <replicate count="90" euler="0 0 0.0698"><site name="ray" zaxis="1 0 0"/></replicate>
      </body>
    </body>
  </worldbody>
  <actuator>
    <general name="l" joint="left" gainprm="5" biastype="affine" biasprm="0 0 -5" dyntype="filterexact" dynprm="0.1"/>
    <general name="r" joint="right" gainprm="5" biastype="affine" biasprm="0 0 -5"/>
  </actuator>
  <sensor>
    <rangefinder name="scan" site="ray" cutoff="3.5"/>
  </sensor>
</mujoco>
"""
